"""What is said? Messages, Zenoh keys, robot description, trace, diagnosis document."""
