"""Fast paths beside plain ones, and what the program survives."""
