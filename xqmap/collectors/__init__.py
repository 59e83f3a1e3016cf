"""Who makes the decisions that training learns from."""
