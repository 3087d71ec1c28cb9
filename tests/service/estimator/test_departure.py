"""Friction and torque scale that follow the machine: in the feed-forward torque, and from one run to the next."""

import json
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from schemas.errors import StorageError
from schemas.messages import SampleFlag
from service.estimator import departure
from service.estimator.departure import BALLS, COUNT, LOWER, OWN, PARTS, SCALE
from service.estimator.estimator import Estimator
from service.estimator.keep import Keeper
from tests.known import PERIOD, learnt

LATE = slice(3000, None)  # samples
PRIOR = np.array([0.6, 0.2, 0.15, 0.03] * 3 + [0.1])


def slopes_of(shape):
    """(3, COUNT) of a sample's (3, PARTS): what each departure does to the joints."""
    own = np.kron(np.eye(3), np.ones(OWN)) * np.tile(shape[:, :OWN], 3)
    return np.column_stack([own, shape[:, BALLS]])


def rubbed(robot, known):
    """Identified friction (N, 3) N m of a motion."""
    found, way = robot.identified, np.clip(known.theta_dot / 0.01, -1, 1)
    return found.viscous_friction_nms.value * known.theta_dot + found.coulomb_friction_nm.value * way


def ran(robot, make, share, noise=0.25):
    """An estimator behind 5 s of a gear whose friction is more by `share`, its answers, and the torque that it took."""
    known = make(5.0)
    true = known.samples["torque"] + share * rubbed(robot, known)
    known.samples["torque"] = true + np.random.default_rng(3).normal(0.0, noise, true.shape)
    estimator = Estimator(robot, PERIOD)
    return estimator, estimator.run(known.samples).feedforward, true


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize("share", [0.3, -0.3], ids=["cold", "warm"])
def test_feedforward_is_for_the_friction_of_now(robot, make, share):
    _, plain, of_model = ran(robot, make, 0.0)
    _, answers, true = ran(robot, make, share)
    missed = rms(answers["torque"] - true)
    assert rms(answers["torque"][LATE] - true[LATE]) < rms(plain["torque"][LATE] - of_model[LATE]) + 0.3 * rms(
        (true - of_model)[LATE]
    ), f"{missed:.3g} N m"
    assert not (answers["flags"] & SampleFlag.FRICTION_HELD).any()


def test_friction_that_is_not_there_is_not_fed_forward(robot, make):
    """At most what the noise makes sure of by chance."""
    estimator, _, _ = ran(robot, make, 0.0)
    assert np.abs(estimator.state["payload"]["departure"]["sure"]).max() < 0.05


def test_no_gear_rubs_that_much_more(robot, make):
    """What no drift of a gear explains is fed forward to its bound, and said to be there."""
    estimator, answers, _ = ran(robot, make, 0.7)
    learnt = estimator.state["payload"]["departure"]
    prior = departure.drift(
        np.array(robot.identified.viscous_friction_nms.value), np.array(robot.identified.coulomb_friction_nm.value)
    )
    assert (np.abs(learnt["sure"]) <= departure.BOUND * prior).all()
    assert (answers["flags"][LATE] & SampleFlag.FRICTION_HELD).any()


def test_friction_is_least_squares_at_right_angles_to_the_load():
    """Two blocks of samples, the second of half the worth, by matrices: what a mass could be is taken out of each."""
    random, state = np.random.default_rng(4), np.zeros(1, departure.STATE)
    prior = PRIOR
    departure.start(state, prior)
    state, forgetting = state[0], 0.9
    np.testing.assert_allclose(state["covariance"], np.diag([0.36, 0.04, 0.0225, 0.0009] * 3 + [0.01]))
    truth = np.array([0.5, -0.1, 0.2, 0.03, -6.0, 0.2, 0.1, -0.02, 5.0, 0.0, -0.1, 0.01, 0.2])  # two beyond
    information, moment = np.zeros((COUNT, COUNT)), np.zeros(COUNT)
    for inflation in (1.0, 2.0):
        gained, pulled = np.zeros((COUNT, COUNT)), np.zeros(COUNT)
        for row in range(200):
            weights, loads, pulls, shapes = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros((3, PARTS))
            for _ in range(1 + row % 3):
                phi, known, weight = random.uniform(-3, 3, 3), random.standard_normal(3), random.uniform(0.1, 4.0, 3)
                weight[2 if row % 7 == 0 else 1] *= row % 5 > 0  # a joint that rests says nothing
                moved = 20.0 * random.standard_normal(3)
                rub, speed, balls = random.choice([-1.0, 1.0], 3), random.uniform(-5, 5, 3), random.uniform(-3, 3, 3)
                x = np.stack([rub, speed, np.ones(3), moved, balls], axis=1)
                residual = 1.3 * phi + known + slopes_of(x) @ truth + random.standard_normal(3) / 3
                departure.gather_kernel(state, np.repeat(phi[:, None], 3, axis=1), residual, known, weight, x)
                weights, loads, pulls = weights + weight, loads + weight * phi, pulls + weight * (residual - known)
                shapes += weight[:, None] * x
            departure.eliminate_kernel(state)
            moving = weights > 0.0
            whole = np.where(moving, weights, 1.0)
            root, slopes = np.diag(np.sqrt(weights)), slopes_of(shapes / whole[:, None])
            load = root @ (loads / whole)
            across = root @ (np.eye(3) - np.outer(load, load) / (load @ load)) @ root
            gained += slopes.T @ across @ slopes
            pulled += slopes.T @ across @ (pulls / whole)
        departure.learn_kernel(state, prior, forgetting, inflation)
        information = forgetting * information + gained / inflation
        moment = forgetting * moment + pulled / inflation
    covariance = np.linalg.inv(information + np.diag(1 / prior**2))
    found = covariance @ moment
    np.testing.assert_allclose(state["covariance"], covariance, rtol=1e-6, atol=1e-12)
    assert found[8] > departure.BOUND * prior[8]
    assert found[4] < -departure.BOUND * prior[4]
    found[[4, 8]] = departure.BOUND * prior[[4, 8]] * [-1, 1]
    np.testing.assert_allclose(state["delta"], found, rtol=1e-6, atol=1e-9)
    assert state["held"]
    beyond = np.sign(found) * np.maximum(0.0, np.abs(found) - np.sqrt(np.diag(covariance)))
    np.testing.assert_allclose(state["sure"], beyond, rtol=1e-6, atol=1e-9)
    state["moment"] = 0.0
    departure.learn_kernel(state, prior, forgetting, 1.0)
    assert not state["held"], "nothing is beyond a gear's any more"
    covariance = state["covariance"]
    one, other = random.standard_normal((2, COUNT))
    assert departure.covariance_kernel(state, one, other) == pytest.approx(one @ covariance @ other)


def test_a_doubt_is_what_was_not_learnt_and_the_error_of_what_was():
    """Masses weighed on gears drawn at random, each learnt of by samples drawn at random."""
    random, state = np.random.default_rng(5), np.zeros(1, departure.STATE)[0]
    rows, does = random.standard_normal((6, COUNT)) / PRIOR, random.standard_normal(COUNT)
    learnt = np.linalg.inv(rows.T @ rows + np.diag(PRIOR**-2))
    true, noise = PRIOR * random.standard_normal((100_000, COUNT)), random.standard_normal((100_000, 6))
    missed, taught = (true @ rows.T @ rows @ learnt - true) @ does, noise @ rows @ learnt @ does
    state["covariance"] = learnt
    whole, unlearnt = departure.doubt_kernel(state, PRIOR, does)
    assert whole == pytest.approx(does @ learnt @ does)
    assert unlearnt == pytest.approx(np.var(missed), rel=0.02)
    assert whole - unlearnt == pytest.approx(np.var(taught), rel=0.02)
    state["covariance"] = np.diag(PRIOR**2)
    assert departure.doubt_kernel(state, PRIOR, does) == pytest.approx((np.sum((PRIOR * does) ** 2),) * 2)
    state["covariance"] = 4.0 * np.diag(PRIOR**2)
    whole, unlearnt = departure.doubt_kernel(state, PRIOR, does)
    assert unlearnt == whole, "no more than all of it"


def test_noise_of_the_acceleration_makes_no_friction_of_a_load():
    """In slow motion, all one way, the torque of a load is what friction along it would be: nothing is to be learnt."""
    random, states = np.random.default_rng(5), np.zeros(1, departure.STATE)
    departure.start(states, PRIOR)
    (state,) = states
    steady, weight, x = np.array([-0.5, -1.3, -2.7]), np.ones(3), np.zeros((3, PARTS))
    x[:, 0] = -1.0
    noise = random.standard_normal((1001, 3))
    for few in 0.01 * np.diff(noise, axis=0).reshape(-1, 5, 3):
        for sample in few:
            phi = steady + sample
            residual = 3.8 * steady - 4.0 * sample  # of the arms and drives
            departure.gather_kernel(state, np.repeat(phi[:, None], 3, axis=1), residual, np.zeros(3), weight, x)
        departure.eliminate_kernel(state)
    departure.learn_kernel(state, PRIOR, 1.0, 0.2)
    assert np.abs(state["delta"]).max() < 0.1


def test_a_small_scale_is_left_out_and_counted():
    """It may be an inertia that is a little wrong: the rest is what it is without, and the difference is error."""
    random, prior = np.random.default_rng(7), PRIOR
    states = np.zeros(1, departure.STATE)
    departure.start(states, prior)
    (state,) = states
    slopes = random.standard_normal((40, COUNT)) * [*[3.0, 5.0, 3.0, 300.0] * 3, 300.0]
    state["information"] = information = slopes.T @ slopes
    known, scales = information + np.diag(prior**-2), np.arange(SCALE, COUNT, OWN)
    covariance = np.linalg.inv(known)
    for largest, changed in ((0.019, 0), (0.021, 1), (-0.011, 1), (0.009, 0), (-0.021, 1)):
        found = 0.05 * random.standard_normal(COUNT)
        found[scales], found[-1] = [0.005, largest, 0.0], 0.2
        state["block_information"], state["block_moment"] = information[LOWER], known @ found
        departure.learn_kernel(state, prior, 0.0, 1.0)
        assert state["changed"] == changed, largest
        without = found - covariance[:, scales] @ np.linalg.solve(covariance[np.ix_(scales, scales)], found[scales])
        expected = found if changed else without
        np.testing.assert_allclose(state["delta"], expected, rtol=1e-6, atol=1e-9)
        error = found - expected
        np.testing.assert_allclose(state["covariance"], covariance + np.outer(error, error), rtol=1e-6, atol=1e-9)
    unsure = slopes * [*[1.0, 1.0, 1.0, 0.01] * 3, 1.0]
    information = unsure.T @ unsure
    state["block_information"], state["block_moment"] = information[LOWER], (information + np.diag(prior**-2)) @ found
    departure.learn_kernel(state, prior, 0.0, 1.0)
    assert state["changed"] == 0, "nothing that stands out of its error"


def test_ball_joints_that_hardly_rub_are_left_out():
    """What the model lacks looks like so little, too."""
    random = np.random.default_rng(9)
    states = np.zeros(1, departure.STATE)
    departure.start(states, PRIOR)
    (state,) = states
    slopes = random.standard_normal((40, COUNT)) * [*[3.0, 5.0, 3.0, 300.0] * 3, 300.0]
    information = slopes.T @ slopes
    known = information + np.diag(PRIOR**-2)
    covariance = np.linalg.inv(known)
    for rubs, worn in ((0.029, 0), (0.031, 1), (-0.016, 1), (0.014, 0)):
        found = np.append(0.05 * random.standard_normal(COUNT - 1), rubs)
        found[SCALE] = 0.05
        state["block_information"], state["block_moment"] = information[LOWER], known @ found
        departure.learn_kernel(state, PRIOR, 0.0, 1.0)
        assert state["worn"] == worn, rubs
        without = found - covariance[:, -1] * rubs / covariance[-1, -1]
        np.testing.assert_allclose(state["delta"], found if worn else without, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(state["covariance"], covariance, rtol=1e-6, atol=1e-12)


def test_what_the_newest_blocks_taught_can_be_unlearnt():
    random, prior = np.random.default_rng(8), PRIOR
    states = np.zeros(1, departure.STATE)
    departure.start(states, prior)
    (state,) = states
    after = [(state["information"].copy(), state["moment"].copy())]
    for _ in range(13):
        slopes = random.standard_normal((15, COUNT))
        state["block_information"], state["block_moment"] = (slopes.T @ slopes)[LOWER], random.standard_normal(COUNT)
        departure.learn_kernel(state, prior, 0.9, 1.0)
        after.append((state["information"].copy(), state["moment"].copy()))
    for _ in range(2):
        state["block_information"] = state["block_moment"] = state["sum_weight"] = 1.0
        departure.unlearn_kernel(state, prior)
        np.testing.assert_array_equal(state["information"], after[4][0])
        np.testing.assert_array_equal(state["moment"], after[4][1])
        assert not state["block_information"].any()
        assert not state["block_moment"].any()
        assert not state["sum_weight"].any()
    departure.learn_kernel(state, prior, 1.0, 1.0)
    expected = np.linalg.inv(after[4][0] + np.diag(prior**-2))
    np.testing.assert_allclose(np.diag(state["covariance"]), np.diag(expected), rtol=0.5)


def test_what_is_left_of_a_departure_after_a_while_is_a_gauss_markov_process():
    random, prior, share = np.random.default_rng(6), PRIOR, 0.7
    slopes = random.standard_normal((20, COUNT))
    information, moment = slopes.T @ slopes, random.standard_normal(COUNT)
    mean = np.linalg.solve(information + np.diag(prior**-2), moment)
    covariance = np.linalg.inv(information + np.diag(prior**-2))
    later = departure.aged(information, moment, prior, share)
    then = np.linalg.inv(later[0] + np.diag(prior**-2))
    np.testing.assert_allclose(then, share**2 * covariance + (1 - share**2) * np.diag(prior**2), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(then @ later[1], share * mean, rtol=1e-9)


def test_a_gear_drifts_by_a_share_of_its_friction_and_by_a_little_at_least():
    np.testing.assert_allclose(
        departure.drift(np.array([-2.0, 0.1, 4.0]), np.array([3.0, 0.1, 0.0])),
        [0.45, 0.3, 0.15, 0.03, 0.15, 0.05, 0.15, 0.03, 0.15, 0.6, 0.15, 0.03, 0.1],
    )


@pytest.fixture
def kept(robot, make, tmp_path):
    """The file of a robot whose gears rub 30 % more."""
    estimator, _, _ = ran(robot, make, 0.3)
    path = tmp_path / "friction.json"
    Keeper(path, robot).close(estimator)
    return path, estimator


def after_a_restart(robot, make, path):
    """A new estimator with what was kept, as soon as a joint has moved a little, and what was said."""
    estimator = Estimator(robot, PERIOD)
    said = Keeper(path, robot).begin(estimator)
    known = make(0.2, noise=0.25)
    known.samples["torque"] += 0.3 * rubbed(robot, known)
    estimator.run(known.samples)
    return estimator, said


def change(path, **fields):
    path.write_text(json.dumps(json.loads(path.read_text()) | fields))


def ago(**time):
    return (datetime.now(UTC) - timedelta(**time)).isoformat()


def test_what_is_learnt_is_written_while_it_runs_but_not_all_the_time(robot, tmp_path, capsys):
    path, estimator = tmp_path / "kept" / "friction.json", Estimator(robot, PERIOD)
    path.parent.mkdir()
    keeper = Keeper(path, robot)

    def noted():
        keeper.note(estimator)
        if keeper._writing is not None:
            keeper._writing.join()
        return path.exists()

    assert not noted(), "within a minute"
    keeper._due -= timedelta(minutes=1)
    assert noted()
    Keeper(path, robot)  # is whole
    path.unlink()
    assert not noted(), "written a moment ago"
    path.parent.rmdir()
    for _ in range(2):
        keeper._due -= timedelta(minutes=1)
        noted()
    assert capsys.readouterr().err.count("estimate: --keep: ") == 1, "told once, and the estimator goes on"


def test_friction_outlives_a_restart(robot, make, kept):
    path, before = kept
    estimator, said = after_a_restart(robot, make, path)
    np.testing.assert_allclose(learnt(estimator)[0], learnt(before)[0], atol=0.1)
    assert "used with weight 100%" in said
    anew, _ = after_a_restart(robot, make, path.with_name("none.json"))
    assert rms(learnt(anew)[0] - learnt(before)[0]) > 3 * rms(learnt(estimator)[0] - learnt(before)[0])


def test_a_change_of_load_found_soon_after_a_restart_does_not_take_what_was_kept(robot, kept):
    """It unlearns the newest blocks, and there are none yet."""
    path, _ = kept
    estimator = Estimator(robot, PERIOD)
    Keeper(path, robot).begin(estimator)
    friction = estimator.state["payload"]["departure"]
    information, moment = friction["information"].copy(), friction["moment"].copy()
    assert moment.any()
    for _ in range(2):
        departure.unlearn_kernel(friction, PRIOR)
        np.testing.assert_array_equal(friction["information"], information)
        np.testing.assert_array_equal(friction["moment"], moment)


def test_what_was_learnt_yesterday_says_little_of_a_cold_gear(robot, make, kept):
    path, _ = kept
    change(path, written_at=ago(hours=12))
    estimator, said = after_a_restart(robot, make, path)
    anew, _ = after_a_restart(robot, make, path.with_name("none.json"))
    assert "used with weight 0%" in said
    np.testing.assert_allclose(learnt(estimator)[0], learnt(anew)[0], atol=0.02)


@pytest.mark.parametrize(("period", "used"), [(5e-4, False), (1.0005e-3, True), (0.9995e-3, True), (1.0015e-3, False)])
def test_what_was_learnt_at_another_rate_is_not_used(robot, kept, period, used):
    path, _ = kept
    estimator = Estimator(robot, period)
    assert ("period_s 0.001" in Keeper(path, robot).begin(estimator)) is not used
    assert estimator.state["payload"]["departure"]["information"].any() == used


def test_an_hour_leaves_a_third_of_what_was_learnt(robot, kept):
    """By the drift of what was identified; a joint that never moved is no fault of the file."""
    path, _ = kept
    information = np.diag([0.0, *range(1, COUNT)]).astype(float)
    change(path, written_at=ago(hours=1), information=information.tolist(), moment=[0.0, *[2.0] * (COUNT - 1)])
    estimator = Estimator(robot, PERIOD)
    assert "60 min ago is used with weight 37%" in Keeper(path, robot).begin(estimator)
    found = robot.identified
    prior = departure.drift(np.array(found.viscous_friction_nms.value), np.array(found.coulomb_friction_nm.value))
    left = departure.aged(information, np.array([0.0, *[2.0] * (COUNT - 1)]), prior, np.exp(-1.0))
    begun = estimator.state["payload"]["departure"]
    np.testing.assert_allclose(begun["information"], left[0], rtol=1e-3, atol=1e-9)
    np.testing.assert_allclose(begun["moment"], left[1], rtol=1e-3, atol=1e-9)


def test_clocks_may_differ_by_a_minute(robot, kept):
    path, _ = kept
    change(path, written_at=ago(seconds=-50))
    assert "used with weight 100%" in Keeper(path, robot).begin(Estimator(robot, PERIOD))
    change(path, written_at=ago(seconds=-90))
    with pytest.raises(StorageError, match="in the future"):
        Keeper(path, robot)


SKEW = np.eye(COUNT)
SKEW[0, 1] = 0.5


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"robot": "other"}, "robot: kept for 'other', this is"),
        ({"description": "0" * 64}, "description: kept for another"),
        ({"written_at": ago(days=-1)}, "written_at: "),
        ({"information": SKEW.tolist()}, "information: not symmetric"),
        ({"information": np.diag([1.0] * (COUNT - 1) + [-1.0]).tolist()}, "information: not positive"),
        ({"moment": [float("nan")] * COUNT}, "moment.0: "),
        ({"moment": [0.0] * (COUNT - 1)}, "moment: "),
        ({"schema": "deltatwin.friction/9"}, "schema: "),
        ({"period_s": 0.0}, "period_s: "),
        ({"more": 1}, "more: unknown key"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else None,
)
def test_a_file_that_is_not_this_robots_is_refused(robot, kept, fields, said):
    path, _ = kept
    change(path, **fields)
    before = path.read_bytes()
    with pytest.raises(StorageError) as error:
        Keeper(path, robot)
    assert str(error.value).startswith(f"{path}: {said}")
    assert path.read_bytes() == before


@pytest.mark.parametrize("content", [b"", b"[]", b"{", b"name = 'd3'", b"\xff", b"[" * 60_000, b" " * 70_000])
def test_a_file_that_is_something_else_is_refused(robot, tmp_path, content):
    path = tmp_path / "identified.toml"
    path.write_bytes(content)
    with pytest.raises(StorageError, match=str(path)):
        Keeper(path, robot)


def test_another_identification_makes_another_departure(robot, kept):
    path, _ = kept
    identified = robot.identified.model_copy(update={"friction_transition_radps": 0.123})
    with pytest.raises(StorageError, match="description"):
        Keeper(path, robot.model_copy(update={"identified": identified}))
