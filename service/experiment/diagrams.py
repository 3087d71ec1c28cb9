"""The paper's two block diagrams, figures 2 and 9, drawn anew from its method."""

from __future__ import annotations

from service.experiment.pictures import Arrow, Box, Diagram

IDENTIFICATION = Diagram(
    "figure_2",
    "Figure 2: how the gray-box model is identified",
    "Drawn by us from the method, not copied. A net analyzer takes joint positions and torques off the EtherCAT bus; "
    "ρ1 and ρ2 come from a grid search on each trajectory, friction from least squares on the residual, and both are "
    "means over the trajectories.",
    (
        Box("robot\nSIPRO D3-1200", 0, 0),
        Box("net analyzer\non EtherCAT", 1, 0),
        Box("θ̇, θ̈ from θ", 2, 0),
        Box("terms of M_KH\nI θ̈,  G(θ),  Jᵀ M Ẍ", 3, 0),
        Box("grid search, each trajectory\nmin RMS(τ − ρ1 I θ̈ − ρ2 G − Jᵀ M Ẍ)", 2.5, 1.5),
        Box("mean over trajectories\nρ1, ρ2:  M_Id", 0.6, 1.5),
        Box("least squares, each joint\nτ − τ̂ = f_v θ̇ + f_c sign θ̇", 2.5, 3),
        Box("mean over trajectories\nf_v, f_c:  M_Id+F", 0.6, 3),
    ),
    (
        Arrow(0, 1),
        Arrow(1, 2, "θ"),
        Arrow(2, 3),
        Arrow(3, 4),
        Arrow(1, 4, "τ"),
        Arrow(4, 5),
        Arrow(4, 6, "residual"),
        Arrow(6, 7),
    ),
)

WEIGHING = Diagram(
    "figure_9",
    "Figure 9: how the payload is estimated and used",
    "Drawn by us from the method, not copied, with its misprints corrected: the difference between measured and "
    "predicted torque is projected onto the platform; recursive least squares with forgetting estimate the payload.",
    (
        Box("net analyzer\non EtherCAT", 0, 1),
        Box("θ̇, θ̈ from θ", 1, 0),
        Box("inverse dynamics\nM_Id+F, m_p = 0", 2, 0),
        Box("ΔT = τ − τ̂", 2, 1.5),
        Box("y = −A K⁻¹ ΔT\nX = p̈ + (0, 0, g)", 3, 1.5),
        Box("recursive least squares\nm̂_p ← m̂_p + k (y − X m̂_p)", 2.8, 3),
        Box("feed-forward torque\nτ_FF = τ̂ + Jᵀ m̂_p X", 1, 3),
        Box("controller,\nrobot", 0, 3),
    ),
    (
        Arrow(0, 1, "θ"),
        Arrow(1, 2),
        Arrow(2, 3, "τ̂"),
        Arrow(0, 3, "τ"),
        Arrow(3, 4),
        Arrow(4, 5),
        Arrow(5, 6, "m̂_p"),
        Arrow(6, 7),
    ),
)
