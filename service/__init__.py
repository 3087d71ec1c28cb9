"""What does it mean? Model, estimator, monitor, identification, diagnosis, commands."""
