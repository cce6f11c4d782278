"""What files say of themselves, held against what they hold."""
