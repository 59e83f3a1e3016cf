"""What is done to the program on purpose: it is killed, its world and disk are broken, it is fed nonsense, and it is
left running.
"""
