"""Arms of six and seven joints as URDFs, their logs by MuJoCo, with and without a load on the flange."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo's compiled modules carry no types)

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

PERIOD, SECONDS = 4e-3, 12.0


@dataclass(frozen=True)
class Load:
    """mass: kg. centre: m in the flange's frame. inertia: kg m^2 about the centre, along the frame's axes."""

    mass: float
    centre: tuple[float, float, float]
    inertia: tuple[float, float, float]


@dataclass(frozen=True)
class Kind:
    """joints: place xyz and rpy in the link before. masses: kg. lengths: m, of rods along each link. noise: N m."""

    name: str
    joints: tuple[tuple[str, str], ...]
    masses: tuple[float, ...]
    sizes: tuple[float, ...]
    noise: tuple[float, ...]

    @property
    def count(self) -> int:
        """n."""
        return len(self.joints)

    def urdf(self, load: Load | None = None, scale: float = 1.0) -> str:
        """scale: of all masses."""
        parts = [f'<robot name="{self.name}"><link name="base"/>']
        for number, (mass, size) in enumerate(zip(self.masses, self.sizes, strict=True), start=1):
            draw = np.random.default_rng(number)
            centre = size * np.r_[draw.uniform(0.2, 0.5), draw.uniform(-0.15, 0.15, 2)]
            parts.append(_link(f"l{number}", Load(mass * scale, tuple(centre), _rod(mass * scale, size))))
        parts.append('<link name="flange"/>' if load is None else _link("flange", load))
        for number, (xyz, rpy) in enumerate(self.joints, start=1):
            parent = f"l{number - 1}" if number > 1 else "base"
            parts.append(
                f'<joint name="j{number}" type="revolute"><parent link="{parent}"/><child link="l{number}"/>'
                f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="0 0 1"/>'
                '<limit lower="-2.9" upper="2.9" effort="300" velocity="4"/></joint>'
            )
        parts.append(
            f'<joint name="mount" type="fixed"><parent link="l{self.count}"/><child link="flange"/>'
            '<origin xyz="0 0 0.08" rpy="0 0 0.4"/></joint></robot>'
        )
        return "\n".join(parts)

    def description(self) -> str:
        """TOML beside `arm.urdf`."""
        names = ", ".join(f'"j{number}"' for number in range(1, self.count + 1))
        return f'name = "{self.name}"\nkind = "chain"\nurdf = "arm.urdf"\njoints = [{names}]\n'

    def torque(self, signals: list[np.ndarray], load: Load | None) -> np.ndarray:
        """(N, n) N m that MuJoCo says the joints need."""
        model = mujoco.MjModel.from_xml_string(self.urdf(load))
        data, result = mujoco.MjData(model), np.empty(signals[0].shape)
        for row, (angle, speed, acceleration) in enumerate(zip(*signals, strict=True)):
            data.qpos[:], data.qvel[:], data.qacc[:] = angle, speed, acceleration
            mujoco.mj_inverse(model, data)
            result[row] = data.qfrc_inverse
        return result

    def record(
        self, path: Path, seed: int, load: Load | None = None, period: float = PERIOD, seconds: float = SECONDS,
        encoder: float = 0.0,
    ) -> Path:  # fmt: skip
        """A log with friction, rotors, constant load and white noise, in our own CSV. encoder: rad of noise."""
        time = np.arange(round(seconds / period)) * period
        signals, draw = self.motion(seed, time), np.random.default_rng(1000 + seed)
        needed = self.needed(signals, load) + draw.normal(0, 1, signals[0].shape) * self.noise
        read = signals[0] + draw.normal(0, 1, signals[0].shape) * encoder
        header = "time_s," + ",".join(
            f"{name}_{j}_{unit}"
            for name, unit in (("position", "rad"), ("torque", "nm"))
            for j in range(1, self.count + 1)
        )
        table = np.column_stack([time, read, needed])
        np.savetxt(path, table, "%.9g", ",", header=header, comments="")
        return path

    def needed(self, signals: list[np.ndarray], load: Load | None = None) -> np.ndarray:
        """(N, n) N m that the drives need, with friction, rotors and constant load."""
        size = np.array(self.noise) * 40
        rubs = 0.2 * size * signals[1] + 0.25 * size * np.sign(signals[1]) + 0.05 * size
        return self.torque(signals, load) + rubs + 0.02 * size * signals[2]

    def motion(self, seed: int, time: np.ndarray) -> list[np.ndarray]:
        """Angle, speed, acceleration (N, n) of sums of sines."""
        draw, signals = np.random.default_rng(seed), [np.zeros((len(time), self.count)) for _ in range(3)]
        for joint in range(self.count):
            for size, hertz in ((0.9, 0.2), (0.35, 0.6), (0.1, 1.7)):
                rate = 2 * np.pi * hertz * draw.uniform(0.8, 1.25)
                wave = size * np.exp(1j * (rate * time + draw.uniform(0, 6)))
                for order, signal in enumerate(signals):
                    signal[:, joint] += ((1j * rate) ** order * wave).imag
        return signals


def _rod(mass: float, size: float) -> tuple[float, float, float]:
    across = mass * size**2 / 12
    return across / 5, across, 1.1 * across


def _link(name: str, body: Load) -> str:
    x, y, z = body.inertia
    return (
        f'<link name="{name}"><inertial><origin xyz="{" ".join(f"{v:.6g}" for v in body.centre)}"/>'
        f'<mass value="{body.mass:.6g}"/>'
        f'<inertia ixx="{x:.6g}" iyy="{y:.6g}" izz="{z:.6g}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


UP, SIDE, BACK = "0 0 0", "1.5707963 0 0", "-1.5707963 0 0"
SIX = Kind(
    "six",
    (("0 0 0.2", UP), ("0.05 0 0.1", SIDE), ("0.4 0 0", UP), ("0.35 0 0", UP), ("0 -0.1 0", SIDE), ("0 0.1 0", BACK)),
    (7.0, 11.0, 6.0, 2.0, 1.8, 0.6),
    (0.2, 0.45, 0.4, 0.12, 0.12, 0.06),
    (0.2, 0.3, 0.15, 0.04, 0.04, 0.03),
)
SEVEN = Kind(
    "seven",
    (
        ("0 0 0.3", UP), ("0 0 0", BACK), ("0 -0.3 0", SIDE), ("0.08 0 0", SIDE), ("-0.08 0.35 0", BACK),
        ("0 0 0", SIDE), ("0.09 0 0", SIDE),
    ),
    (4.0, 3.0, 3.2, 3.1, 2.9, 1.6, 0.7),
    (0.25, 0.25, 0.25, 0.25, 0.25, 0.12, 0.08),
    (0.1, 0.1, 0.08, 0.08, 0.03, 0.03, 0.02),
)  # fmt: skip
FOUR = Kind(
    "four",
    (("0 0 0.25", UP), ("0.03 0 0.1", SIDE), ("0.3 0 0", UP), ("0.28 0 0", BACK)),
    (5.0, 4.5, 3.0, 0.9),
    (0.2, 0.35, 0.3, 0.1),
    (0.15, 0.2, 0.1, 0.03),
)
