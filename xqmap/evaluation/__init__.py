"""How good a policy is: played, compared, counted and laid out in tables."""
