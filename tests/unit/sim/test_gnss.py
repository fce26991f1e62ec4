import itertools
import math
import statistics
from random import Random

from visloc_companion.sim.faults import GnssEffect
from visloc_companion.sim.gnss import GnssReceiver, ReceiverErrors

REST = ((10.0, 20.0, -30.0), (1.0, 2.0, 0.0))


def samples(receiver, effects):
    return [receiver.sample(i * receiver.period_s, *REST, effect) for i, effect in enumerate(effects)]


def test_errors_are_as_large_as_stated_and_correlated():
    receiver = GnssReceiver(Random(4))
    norths = [s.p_ned_m[0] - 10.0 for s in samples(receiver, [GnssEffect()] * 20000)]
    assert 0.3 < statistics.pstdev(norths) < 0.46  # hypot(0.35, 0.15) = 0.38
    steps = [b - a for a, b in itertools.pairwise(norths)]
    assert statistics.pstdev(steps) < 0.25  # the slow part does not jump


def test_a_jammed_receiver_loses_its_fix_at_once_and_needs_time_to_come_back():
    receiver = GnssReceiver(Random(1))
    good, jammed = GnssEffect(), GnssEffect(jammed=True)
    found = samples(receiver, [good] * 5 + [jammed] * 10 + [good] * 30)
    assert (found[4].fix_type, found[4].n_satellites) == (6, 10)
    assert (found[5].fix_type, found[5].n_satellites) == (1, 3)
    assert found[5].p_ned_m == found[4].p_ned_m
    assert found[5].h_acc_m == found[4].h_acc_m
    back = next(s for s in found[15:] if s.has_fix)
    assert 2.9 <= back.t_s - found[14].t_s <= 3.3


def test_a_spoofed_receiver_reports_the_false_place_with_a_good_fix():
    receiver = GnssReceiver(Random(2))
    sample = receiver.sample(0.0, *REST, GnssEffect(False, (30.0, 0.0, 0.0), (1.0, 0.0, 0.0)))
    assert sample.has_fix
    assert math.isclose(sample.p_ned_m[0], 40.0, abs_tol=2.0)
    assert math.isclose(sample.v_ned_mps[0], 2.0, abs_tol=0.5)
    assert sample.false_ned_m == (30.0, 0.0, 0.0)


def test_a_cheap_receiver_wanders_further():
    receiver = GnssReceiver(Random(4), errors=ReceiverErrors(slow_m=2.0, slow_s=20.0, white_m=0.0))
    norths = [s.p_ned_m[0] - 10.0 for s in samples(receiver, [GnssEffect()] * 20000)]
    assert 1.7 < statistics.pstdev(norths) < 2.3


def test_meaconing_shows_another_antennas_place_at_rest():
    sample = GnssReceiver(Random(2)).sample(0.0, *REST, GnssEffect(meacon_ned_m=(500.0, 0.0, -3.0)))
    assert sample.has_fix
    assert math.dist(sample.p_ned_m, (500.0, 0.0, -3.0)) < 4.0
    assert math.hypot(*sample.v_ned_mps) < 0.5
    assert sample.false_ned_m == (490.0, -20.0, 27.0)
