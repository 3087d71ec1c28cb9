"""The Delta model: kinematics, dynamics and friction, after "Gray-Box Model Identification and Payload Estimation for
Delta Robots" (IFAC 2020), with its misprints put right.

Frame: origin at the centre of the base, z up, the platform works at z < 0. Joint angle 0 is a horizontal active link,
positive turns it down. alpha_i is the azimuth of arm i, r = base radius - platform radius, l1 and l2 the active and the
passive link, u_i = x0 cos alpha_i + y0 sin alpha_i.

    J'_i = ((r + l1 cos theta_i) cos alpha_i, (r + l1 cos theta_i) sin alpha_i, -l1 sin theta_i)      elbow, shifted by the platform radius
    f_i  = |p - J'_i|^2 - l2^2 = 0                                                                    eq. (1)
    s_i  = p - J'_i                                                                                   forearm

| printed                                                         | consistent with eq. (1), used here                             |
|-----------------------------------------------------------------|----------------------------------------------------------------|
| n_i = 2 r x0 - 2 r y0 sin alpha_i + |p|^2 + l1^2 - l2^2 + r^2   | n_i = 2 r u_i - |p|^2 - l1^2 + l2^2 - r^2                      |
| a_1i = x0 + r cos alpha_i - l1 cos theta_i cos alpha_i          | a_1i = x0 - (r + l1 cos theta_i) cos alpha_i (y likewise)      |
| a_3i = z0 - l1 sin theta_i                                      | a_3i = z0 + l1 sin theta_i, so A = [s_1 s_2 s_3]               |
| k_ii = (u_i + r) sin theta_i - z0 cos theta_i                   | k_ii = l1 [(u_i - r) sin theta_i + z0 cos theta_i]             |
| V_1 = +m1/2 g l1 sum sin theta_i; V_2 = m2 g sum (z0 + l1 sin)  | minus before both l1 sin theta_i terms                         |
| G_i = +(m1/2 + m2) g l1 cos theta_i                             | G_i = -(m1/2 + m2) g l1 cos theta_i                            |
| [f_c f_v]' beside Phi = [theta_dot, sign theta_dot]             | [f_v f_c]'                                                     |
| M_p(k+1) = M_p(k) - K (y - X' M_p)                              | plus                                                           |
| K from X(k+1), innovation from y(k), X(k)                       | all from k+1 (as printed the mass comes out short)             |
| M_p a 3 x 3 unknown                                             | one scalar m_p, three rows a sample                            |

The rows of a_1, a_3, k, V and G have one cause: as printed they are exact in a frame with z from the base towards the
platform, r = platform radius - base radius and weight towards the base, and the paper mixes the two frames. n_i, the l1 of
k_ii, the order of friction and the rows of the recursion are misprints proper.

m2 is half of one forearm's mass (both rods). J = dp/dtheta = -inv(A)' K, so -K inv(A) F = J' F.

    M_KH    T = I theta_ddot + G + J' M X                      I = (m1/3 + m2) l1^2, M = m0 + 3 m2, X = p_ddot + (0, 0, g)
    M_Id    T = rho_1 I theta_ddot + rho_2 G + J' M X
    M_Id+F  T = M_Id + f_v theta_dot + f_c sign theta_dot
    full    T = M_Id+F + forearm + named effects + J' m_p X
"""  # noqa: E501 - a table
