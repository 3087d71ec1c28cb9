"""Payload mass: scalar least squares in information form, with what is not known of friction, and a change detector.

The three torque residuals of a sample are r_i = m_p phi_i + x_i delta_i + noise, phi = J'(p_ddot + g) in N m/kg: the
paper's three Cartesian rows y = m_p X, brought to the joints, where the noise lives, so that each joint weighs by its
own noise. delta is how far friction and torque scale are from the identified ones (`departure`): its estimate is taken
off, its covariance counts in the mass's (a consider state, Schmidt 1966).

`state` what is remembered, `loads` the normal equations, `scatter` how far the noise may be believed, `change` whether
the load is another, `rest` the same while nothing moves, `verdict` what is said, `step` a sample in.
"""
