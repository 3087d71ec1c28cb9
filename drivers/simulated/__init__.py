"""Machines in software: the plant that stands in for a robot, and the drives of a bus segment."""
