"""The person who corrects: pages, folders, interruptions."""
