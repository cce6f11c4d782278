"""How points move, from their tracks: the second half of what features are made of (thesis 6.1, 6.2)."""
