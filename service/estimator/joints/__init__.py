"""The estimator of an arm or of servo axes: the motion and its bounds as of a Delta, the torque by the mechanism."""
