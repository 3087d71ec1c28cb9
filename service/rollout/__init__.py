"""What does the simulated robot do where the real one did what the log says?"""
