"""The online estimator: one sample in; feed-forward torque, payload mass and model errors out, in microseconds."""
