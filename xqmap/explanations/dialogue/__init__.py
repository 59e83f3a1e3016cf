"""Questions about a decision, and their answers."""
