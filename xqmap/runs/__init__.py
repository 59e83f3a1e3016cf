"""Run directories: what they hold, how they are loaded, and what is decided with them."""
