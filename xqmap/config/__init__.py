"""Settings: their types and ranges, what a command makes of them, and where yaml files are found."""
