"""What a user waits for: start, training, installation, checks."""
