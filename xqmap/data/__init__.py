"""Transitions: kept, drawn, turned and mirrored."""
