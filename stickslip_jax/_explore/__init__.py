"""The explorer: a system, its base and its numbers on the left, what they do on the right, in a browser or notebook."""
