"""The second plant's motion: a Delta robot as a closed chain in redundant coordinates, with an integrator of its own.

Coordinates are the three joint angles and the platform's position, six in all; three constraints, one a forearm, keep
each forearm's length. Their forces are Lagrange multipliers, solved for together with the accelerations (index 1), and
what drifts off is drawn back (Baumgarte). Forearms are uniform rods. Time steps: classical Runge-Kutta, 1/8 ms.

Frame, zero and sign of the angles are those of docs/explanation/frames.md. SI throughout, joint side.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from schemas.kernels import kernel

CYCLE_S = 0.25e-3  # of the drives' control, at which all is recorded
SUBSTEPS = 2  # of the integrator in a cycle
DRAWN_BACK = 150.0  # 1/s, how quickly an error of a constraint goes (Baumgarte)
STICKING_RADPS = 4e-3  # speed over which dry friction changes sign; below about 2e-3 the step would be too long for it
STICKING_MPS = 2e-3  # the same of what slides at the platform

ANGLE, PLACE, ANGLE_RATE, SPEED = 0, 3, 6, 9  # where in the state
MOTOR, MOTOR_RATE, BRISTLE, ACTING = 12, 15, 18, 21
SLOSH, SLOSH_RATE, FRAME, FRAME_RATE, CABLE = 24, 26, 28, 30, 32
STATES = 35


class Plant(NamedTuple):
    """All that moves the second plant. Arrays hold an entry a joint unless said otherwise; zero: not there."""

    # Mechanism
    link: np.ndarray  # m, active link
    forearm: np.ndarray  # m
    radius: np.ndarray  # m, of the joint's axis, less that of the platform
    azimuth: np.ndarray  # rad
    link_mass: np.ndarray  # kg
    forearm_mass: np.ndarray  # kg, both rods together
    platform_mass: float  # kg
    rotor: np.ndarray  # kg m^2, joint side
    gravity: np.ndarray  # m/s^2, in the base's frame
    # Friction of the gears
    viscous: np.ndarray  # N m s/rad
    coulomb: np.ndarray  # N m
    stribeck: np.ndarray  # N m
    stribeck_speed: np.ndarray  # rad/s
    one_sided_coulomb: np.ndarray  # N m
    one_sided_viscous: np.ndarray  # N m s/rad
    load_friction: np.ndarray  # share of the torque through the teeth
    power_friction: np.ndarray  # N m at 1 rad/s
    power: float
    wave_friction: np.ndarray  # N m
    wave_order: np.ndarray  # per joint angle
    wave_phase: np.ndarray  # rad
    warm_friction: np.ndarray  # N m s/rad, of the cold gear beside `viscous`
    warm_time: float  # s
    bristle_way: np.ndarray  # rad over which Coulomb friction builds up
    cogging: np.ndarray  # N m
    cogging_order: np.ndarray  # per joint angle: per motor turn times gear ratio
    cogging_phase: np.ndarray  # rad
    # Between motor and link
    stiffness: np.ndarray  # N m/rad; 0: rigid
    damping: np.ndarray  # N m s/rad
    lash: np.ndarray  # rad, the whole gap
    # At the links and the platform
    ball_dry: float  # N m, of a ball joint pair
    ball_viscous: float  # N m s/rad
    spring: np.ndarray  # N m/rad
    spring_zero: np.ndarray  # rad
    hose: float  # N/m
    hose_point: np.ndarray  # m, (3,) in space
    drag: float  # N s^2/m^2
    shaft_dry: float  # N, along the telescopic shaft
    shaft_viscous: float  # N s/m
    # Drive
    lag_hz: np.ndarray  # corner of the torque that acts behind the one that is asked for
    # What no catalogue has
    slosh_mass: float  # kg, part of `platform_mass`'s weight, that moves in its vessel
    slosh_stiffness: float  # N/m
    slosh_damping: float  # N s/m
    shake: np.ndarray  # (n, 5): amplitude m/s^2, Hz, phase, direction x, y of the base's acceleration
    frame_mass: float  # kg, of a soft frame that the base hangs from
    frame_stiffness: float  # N/m
    frame_damping: float  # N s/m
    magnet: float  # N, about, at the distance `magnet_reach`
    magnet_point: np.ndarray  # m, (3,)
    magnet_reach: float  # m
    saturation: np.ndarray  # N m at which a tenth of the torque constant is lost, growing with the square
    knocks: np.ndarray  # (n, 5): start s, duration s, force N (3)
    cable: float  # N, of a cable dragged along
    cable_way: float  # m over which its pull builds up
    jet: float  # N, upwards, of an air jet
    jet_point: np.ndarray  # m, (2,) x, y
    jet_width: float  # m
    rough: np.ndarray  # N m, of a rough spot's friction
    rough_at: np.ndarray  # rad
    rough_width: np.ndarray  # rad
    fading: np.ndarray  # 1/s, share of the torque constant lost
    # Encoder: true angle = (1 + scale) measured + offset + wave cos(order measured + phase)
    encoder_scale: np.ndarray
    encoder_offset: np.ndarray  # rad
    encoder_wave: np.ndarray  # rad
    encoder_order: np.ndarray  # per joint angle
    encoder_phase: np.ndarray  # rad
    # Control
    position_gain: np.ndarray  # N m/rad
    velocity_gain: np.ndarray  # N m s/rad
    integral_gain: np.ndarray  # N m/(rad s)


@kernel(error_model="numpy")
def _solved(matrix, right):
    """Solve in place by Gauss elimination with pivots; the solution is in `right`."""
    size = len(right)
    for k in range(size):
        best = k
        for row in range(k + 1, size):
            if abs(matrix[row, k]) > abs(matrix[best, k]):
                best = row
        if best != k:
            for column in range(k, size):
                matrix[k, column], matrix[best, column] = matrix[best, column], matrix[k, column]
            right[k], right[best] = right[best], right[k]
        for row in range(k + 1, size):
            factor = matrix[row, k] / matrix[k, k]
            if factor != 0.0:
                for column in range(k + 1, size):
                    matrix[row, column] -= factor * matrix[k, column]
                right[row] -= factor * right[k]
    for k in range(size - 1, -1, -1):
        for column in range(k + 1, size):
            right[k] -= matrix[k, column] * right[column]
        right[k] /= matrix[k, k]


@kernel(error_model="numpy")
def _friction(plant, j, angle, rate, bristle, load, time):
    """Friction of one gear and its ripple, N m against the motion."""
    sign = np.tanh(rate / STICKING_RADPS)
    dry = plant.coulomb[j] * (bristle if plant.bristle_way[j] > 0.0 else sign)
    wet = plant.viscous[j] * rate
    if plant.stribeck[j] != 0.0:
        dry += plant.stribeck[j] * np.exp(-((rate / plant.stribeck_speed[j]) ** 2)) * sign
    dry += plant.one_sided_coulomb[j] * sign * sign
    wet += plant.one_sided_viscous[j] * abs(rate)
    dry += plant.load_friction[j] * abs(load) * sign
    if plant.power_friction[j] != 0.0:
        wet += plant.power_friction[j] * abs(rate) ** plant.power * sign
    if plant.wave_friction[j] != 0.0:
        dry += plant.wave_friction[j] * np.cos(plant.wave_order[j] * angle + plant.wave_phase[j]) * sign
    if plant.warm_friction[j] != 0.0:
        wet += plant.warm_friction[j] * np.exp(-time / plant.warm_time) * rate
    if plant.rough[j] != 0.0:
        dry += plant.rough[j] * np.exp(-(((angle - plant.rough_at[j]) / plant.rough_width[j]) ** 2)) * sign
    return dry + wet


@kernel(error_model="numpy")
def _ripple(plant, j, angle):
    if plant.cogging[j] == 0.0:
        return 0.0
    return plant.cogging[j] * np.cos(plant.cogging_order[j] * angle + plant.cogging_phase[j])


@kernel(error_model="numpy")
def _through_teeth(plant, j, turned, rate):
    """Torque that a compliant transmission passes. turned, rate: motor before link."""
    half = 0.5 * plant.lash[j]
    if turned > half:
        pressed = plant.stiffness[j] * (turned - half) + plant.damping[j] * rate
        return pressed if half == 0.0 else max(pressed, 0.0)
    if turned < -half:
        pressed = plant.stiffness[j] * (turned + half) + plant.damping[j] * rate
        return pressed if half == 0.0 else min(pressed, 0.0)
    return plant.damping[j] * rate if half == 0.0 else 0.0


@kernel(error_model="numpy")
def _pull(plant, place, speed, cable, time, force):
    """Add to `force` (3,) what acts on the platform beside weight and forearms."""
    way = np.sqrt(speed[0] ** 2 + speed[1] ** 2 + speed[2] ** 2)
    far = np.sqrt(place[0] ** 2 + place[1] ** 2 + place[2] ** 2)
    lengthening = (place[0] * speed[0] + place[1] * speed[1] + place[2] * speed[2]) / far
    along = plant.shaft_dry * np.tanh(lengthening / STICKING_MPS) + plant.shaft_viscous * lengthening
    beside = np.zeros(3)
    for k in range(3):
        beside[k] = place[k] - plant.magnet_point[k]
        force[k] -= plant.hose * (place[k] - plant.hose_point[k]) + plant.drag * way * speed[k]
        force[k] -= along * place[k] / far + plant.cable * cable[k]
    if plant.magnet != 0.0:
        distance = np.sqrt(beside[0] ** 2 + beside[1] ** 2 + beside[2] ** 2) + 1e-9
        strength = plant.magnet * 4.0 / (1.0 + (distance / plant.magnet_reach) ** 2) ** 2
        for k in range(3):
            force[k] -= strength * beside[k] / (distance + 0.25 * plant.magnet_reach)
    if plant.jet != 0.0:
        off = ((place[0] - plant.jet_point[0]) ** 2 + (place[1] - plant.jet_point[1]) ** 2) / plant.jet_width**2
        force[2] += plant.jet * np.exp(-off)
    for n in range(len(plant.knocks)):
        share = (time - plant.knocks[n, 0]) / plant.knocks[n, 1]
        if 0.0 < share < 1.0:
            for k in range(3):
                force[k] += plant.knocks[n, 2 + k] * np.sin(np.pi * share)


@kernel(error_model="numpy")
def _ball(plant, s, s_rate, length, axis, rate, moment, against):
    """Friction of one forearm's ball joints: `moment` (3,) on the forearm, `against` (3,) that of the elbow alone.

    The forearm turns against the active link at the elbow, and against the platform, which does not turn.
    """
    turn = np.empty(3)
    turn[0] = (s[1] * s_rate[2] - s[2] * s_rate[1]) / length**2
    turn[1] = (s[2] * s_rate[0] - s[0] * s_rate[2]) / length**2
    turn[2] = (s[0] * s_rate[1] - s[1] * s_rate[0]) / length**2
    elbow = turn - axis * rate
    for k in range(3):
        against[k] = -elbow[k] * _loss(plant, elbow)
        moment[k] = against[k] - turn[k] * _loss(plant, turn)


@kernel(error_model="numpy")
def _loss(plant, turn):
    size = np.sqrt(turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2)
    return plant.ball_viscous + plant.ball_dry * np.tanh(size / 0.02) / (size + 1e-9)


@kernel(error_model="numpy")
def _accelerations(plant, state, link_torque, rotor, weight, force, slosh_pull):
    """Solve the closed chain: (9,) of angles (3), platform (3), forearms' forces by length (3).

    link_torque (3,): on the links, N m. rotor (3,): kg m^2 that turns with them. weight (3,): m/s^2. force (3,), N.
    """
    matrix, right = np.zeros((9, 9)), np.zeros(9)
    s, s_rate, moment, against = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    e, e_slope, e_bend, axis = np.empty(3), np.empty(3), np.empty(3), np.zeros(3)
    balls = plant.ball_dry != 0.0 or plant.ball_viscous != 0.0
    for k in range(3):
        mass = plant.platform_mass - (plant.slosh_mass if k < 2 else 0.0)
        matrix[3 + k, 3 + k] = mass
        right[3 + k] = force[k] + plant.platform_mass * weight[k]
    for k in range(2):  # what sloshes carries its own horizontal inertia and weight
        right[3 + k] += slosh_pull[k] - plant.slosh_mass * weight[k]
    for j in range(3):
        rate, length, rod = state[ANGLE_RATE + j], plant.link[j], plant.forearm_mass[j]
        cosine, sine = np.cos(state[ANGLE + j]), np.sin(state[ANGLE + j])
        out = (np.cos(plant.azimuth[j]), np.sin(plant.azimuth[j]))
        for k in range(2):
            e[k] = (plant.radius[j] + length * cosine) * out[k]
            e_slope[k], e_bend[k] = -length * sine * out[k], -length * cosine * out[k]
        e[2], e_slope[2], e_bend[2] = -length * sine, -length * cosine, length * sine
        right[j] = link_torque[j] - plant.spring[j] * (state[ANGLE + j] - plant.spring_zero[j])
        matrix[j, j] = plant.link_mass[j] * length**2 / 3 + rotor[j] + rod * length**2 / 3
        constraint = -(plant.forearm[j] ** 2)
        for k in range(3):
            s[k] = state[PLACE + k] - e[k]
            s_rate[k] = state[SPEED + k] - e_slope[k] * rate
            constraint += s[k] ** 2
            right[j] += weight[k] * e_slope[k] * (plant.link_mass[j] + rod) / 2
            matrix[j, 3 + k] = matrix[3 + k, j] = rod / 6 * e_slope[k]
            matrix[3 + k, 3 + k] += rod / 3
            right[3 + k] += rod / 2 * weight[k] - rod / 6 * e_bend[k] * rate**2
            # constraint's gradient, s on the platform and -s e' on the joint
            matrix[3 + k, 6 + j] = -s[k]
            matrix[6 + j, 3 + k] = s[k]
            matrix[6 + j, j] -= s[k] * e_slope[k]
            right[6 + j] += s[k] * e_bend[k] * rate**2 - s_rate[k] ** 2 - 2 * DRAWN_BACK * s[k] * s_rate[k]
        right[6 + j] -= 0.5 * DRAWN_BACK**2 * constraint
        matrix[j, 6 + j] = -matrix[6 + j, j]
        if balls:
            axis[0], axis[1] = -out[1], out[0]
            _ball(plant, s, s_rate, plant.forearm[j], axis, rate, moment, against)
            for k in range(3):
                turned = (moment[(k + 1) % 3] * s[(k + 2) % 3] - moment[(k + 2) % 3] * s[(k + 1) % 3]) / (
                    plant.forearm[j] ** 2
                )
                right[3 + k] += turned
                right[j] -= turned * e_slope[k] + against[k] * axis[k]
    _solved(matrix, right)
    return right


@kernel(error_model="numpy")
def _weight(plant, state, before, time, out):
    """Gravity less the base's acceleration (3,), in its frame; slopes of the frame that it hangs from in `out`."""
    weight = plant.gravity.copy()
    for n in range(len(plant.shake)):
        shaken = plant.shake[n, 0] * np.sin(2 * np.pi * plant.shake[n, 1] * time + plant.shake[n, 2])
        weight[0] -= shaken * plant.shake[n, 3]
        weight[1] -= shaken * plant.shake[n, 4]
    moved = plant.platform_mass + plant.forearm_mass.sum() / 2
    for k in range(2):
        out[FRAME + k] = out[FRAME_RATE + k] = 0.0
        if plant.frame_mass > 0.0:
            pushed = -moved * before[k] - plant.frame_stiffness * state[FRAME + k]
            out[FRAME + k] = state[FRAME_RATE + k]
            out[FRAME_RATE + k] = (pushed - plant.frame_damping * state[FRAME_RATE + k]) / plant.frame_mass
            weight[k] -= out[FRAME_RATE + k]
    return weight


@kernel(error_model="numpy")
def _slopes(plant, state, asked, load, before, time, out):
    """Slopes of the state into `out`; returns the torque (3,) on the links.

    asked, load, before (3,): torque of the drives, through the teeth, platform's acceleration, of a step ago.
    """
    weight = _weight(plant, state, before, time, out)
    torque, rotor = np.empty(3), np.zeros(3)
    for j in range(3):
        acting = asked[j] if plant.lag_hz[j] == 0.0 else state[ACTING + j]
        out[ACTING + j] = 2 * np.pi * plant.lag_hz[j] * (asked[j] - state[ACTING + j])
        if plant.saturation[j] > 0.0:
            acting /= 1 + (acting / plant.saturation[j]) ** 2 / 9
        acting *= 1 - plant.fading[j] * time
        angle, rate = state[MOTOR + j], state[MOTOR_RATE + j]
        rigid = plant.stiffness[j] == 0.0
        if rigid:
            angle, rate = state[ANGLE + j], state[ANGLE_RATE + j]
        driving = (
            acting - _friction(plant, j, angle, rate, state[BRISTLE + j], load[j], time) - _ripple(plant, j, angle)
        )
        out[BRISTLE + j] = 0.0
        if plant.bristle_way[j] > 0.0:
            out[BRISTLE + j] = (rate - abs(rate) * state[BRISTLE + j]) / plant.bristle_way[j]
        out[MOTOR + j] = rate
        if rigid:
            torque[j], rotor[j] = driving, plant.rotor[j]
        else:
            turned, against = angle - state[ANGLE + j], rate - state[ANGLE_RATE + j]
            torque[j] = _through_teeth(plant, j, turned, against)
            out[MOTOR_RATE + j] = (driving - torque[j]) / plant.rotor[j]
    force, slosh_pull = np.zeros(3), np.zeros(2)
    speed = state[SPEED : SPEED + 3]
    _pull(plant, state[PLACE : PLACE + 3], speed, state[CABLE : CABLE + 3], time, force)
    way = np.sqrt(speed[0] ** 2 + speed[1] ** 2 + speed[2] ** 2)
    for k in range(3):
        out[CABLE + k] = (speed[k] - way * state[CABLE + k]) / plant.cable_way
    for k in range(2):
        slosh_pull[k] = plant.slosh_stiffness * state[SLOSH + k] + plant.slosh_damping * state[SLOSH_RATE + k]
    found = _accelerations(plant, state, torque, rotor, weight, force, slosh_pull)
    for k in range(3):
        out[ANGLE + k], out[ANGLE_RATE + k] = state[ANGLE_RATE + k], found[k]
        out[PLACE + k], out[SPEED + k] = speed[k], found[3 + k]
        if plant.stiffness[k] == 0.0:
            out[MOTOR_RATE + k] = found[k]
    for k in range(2):
        out[SLOSH + k] = state[SLOSH_RATE + k]
        out[SLOSH_RATE + k] = 0.0
        if plant.slosh_mass > 0.0:
            out[SLOSH_RATE + k] = weight[k] - slosh_pull[k] / plant.slosh_mass - found[3 + k]
    return torque


@kernel(error_model="numpy")
def _measured(plant, j, angle):
    """What the encoder says of a motor's angle."""
    scaled = 1 + plant.encoder_scale[j]
    said = (angle - plant.encoder_offset[j]) / scaled
    if plant.encoder_wave[j] != 0.0:
        wave = said
        for _ in range(3):
            wave = (
                said - plant.encoder_wave[j] * np.cos(plant.encoder_order[j] * wave + plant.encoder_phase[j]) / scaled
            )
        said = wave
    return said


@kernel(nogil=True, error_model="numpy")
def run(plant, state, reference, reference_rate, forward, begin):
    """Move the plant along a reference under its control.

    state (35,): at the start, left at what it is in the end. reference, reference_rate, forward (n, 3): angle, speed
    and torque asked for, a row each `CYCLE_S`. begin: s, clock at the start.

    Returns (n, 3) each: measured angle, torque asked of the drives, platform; (n, 2): largest error of a constraint in
    m, energy of the mechanism less its start's, J.
    """
    count, step = len(reference), CYCLE_S / SUBSTEPS
    said, asked, places, checks = np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 2))
    summed, load, before = np.zeros(3), np.zeros(3), np.zeros(3)
    slopes, half = np.zeros((4, STATES)), np.empty(STATES)
    start = energy(plant, state)
    for row in range(count):
        for j in range(3):
            angle = _measured(plant, j, state[MOTOR + j])
            off = reference[row, j] - angle
            summed[j] += plant.integral_gain[j] * off * CYCLE_S
            said[row, j], places[row, j] = angle, state[PLACE + j]
            asked[row, j] = forward[row, j] + plant.position_gain[j] * off + summed[j]
            asked[row, j] += plant.velocity_gain[j] * (reference_rate[row, j] - state[MOTOR_RATE + j])
        checks[row, 0], checks[row, 1] = _stretched(plant, state), energy(plant, state) - start
        for part in range(SUBSTEPS):
            time = begin + row * CYCLE_S + part * step
            torque = _slopes(plant, state, asked[row], load, before, time, slopes[0])
            half[:] = state + 0.5 * step * slopes[0]
            _slopes(plant, half, asked[row], load, before, time + 0.5 * step, slopes[1])
            half[:] = state + 0.5 * step * slopes[1]
            _slopes(plant, half, asked[row], load, before, time + 0.5 * step, slopes[2])
            half[:] = state + step * slopes[2]
            _slopes(plant, half, asked[row], load, before, time + step, slopes[3])
            for j in range(3):
                before[j] = slopes[0, SPEED + j]
                load[j] = torque[j] - (plant.rotor[j] * slopes[0, ANGLE_RATE + j] if plant.stiffness[j] == 0.0 else 0.0)
            state += step / 6 * (slopes[0] + 2 * slopes[1] + 2 * slopes[2] + slopes[3])
    return said, asked, places, checks


@kernel(error_model="numpy")
def _stretched(plant, state):
    """Largest error of a forearm's length, m."""
    worst = 0.0
    for j in range(3):
        radial = plant.radius[j] + plant.link[j] * np.cos(state[ANGLE + j])
        x = state[PLACE] - radial * np.cos(plant.azimuth[j])
        y = state[PLACE + 1] - radial * np.sin(plant.azimuth[j])
        z = state[PLACE + 2] + plant.link[j] * np.sin(state[ANGLE + j])
        worst = max(worst, abs(np.sqrt(x**2 + y**2 + z**2) - plant.forearm[j]))
    return worst


@kernel(error_model="numpy")
def energy(plant, state):
    """Kinetic and potential energy of rigid mechanism and springs in it, J: of what a free plant keeps."""
    total, elbow = 0.0, np.empty(3)
    for k in range(3):
        total += 0.5 * plant.platform_mass * state[SPEED + k] ** 2
        total -= plant.platform_mass * plant.gravity[k] * state[PLACE + k]
        total += 0.5 * plant.hose * (state[PLACE + k] - plant.hose_point[k]) ** 2
    for j in range(3):
        rate, cosine, sine = state[ANGLE_RATE + j], np.cos(state[ANGLE + j]), np.sin(state[ANGLE + j])
        out = (np.cos(plant.azimuth[j]), np.sin(plant.azimuth[j]))
        total += (
            plant.link_mass[j] * (plant.link[j] * rate) ** 2 / 6 + 0.5 * plant.rotor[j] * state[MOTOR_RATE + j] ** 2
        )
        total += 0.5 * plant.spring[j] * (state[ANGLE + j] - plant.spring_zero[j]) ** 2
        total += 0.5 * plant.stiffness[j] * (state[MOTOR + j] - state[ANGLE + j]) ** 2
        for k in range(3):
            away = out[k] if k < 2 else 0.0
            reach = plant.link[j] * (cosine * away if k < 2 else -sine)
            elbow[k] = plant.link[j] * (-sine * away if k < 2 else -cosine) * rate
            other = state[SPEED + k]
            total += plant.forearm_mass[j] / 6 * (elbow[k] ** 2 + elbow[k] * other + other**2)
            total -= plant.link_mass[j] * plant.gravity[k] * (plant.radius[j] * away + reach / 2)
            total -= plant.forearm_mass[j] / 2 * plant.gravity[k] * (plant.radius[j] * away + reach + state[PLACE + k])
    return total
