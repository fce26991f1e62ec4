"""Fixes that scatter by more than they claim are no witness against a good GNSS, also before the filter has learned it."""

from __future__ import annotations

import numpy as np
import pytest

from visloc_companion.core.filter.claims import MOST_APART_SQUARED, NEIGHBOURS_S, Apart, Claim, learned, scattered
from visloc_companion.core.filter.driving import Velocity
from visloc_companion.core.filter.propagation import Drive
from visloc_companion.core.gnss import GnssMonitor
from visloc_companion.core.gnss_aiding import GnssAiding
from visloc_companion.core.settings import CoreSettings
from visloc_companion.core.tracking import Tracker
from visloc_companion.geo import wgs84
from visloc_companion.types import Accepted, AutopilotKind, EkfSource, Fix, GeoPoint, Gnss, Mode

S = 1_000_000_000
ORIGIN = GeoPoint(59.3, 18.1, 40.0)
RATE_HZ = 4


def at(ne_m: np.ndarray) -> GeoPoint:
    return wgs84.geo_from_ned((float(ne_m[0]), float(ne_m[1]), -100.0), ORIGIN)


def factors(scatter_over_claim: float, n: int, seed: int = 1, every_s: float = 0.25) -> list[float]:
    """`scattered` after each of n fixes of a vehicle that stands."""
    rng = np.random.default_rng(seed)
    claims: tuple[Claim, ...] = ()
    found = []
    for k in range(n):
        north, east = (scatter_over_claim * rng.standard_normal(2)).tolist()
        claims = learned(claims, "deep", (0.0, 0.0), Apart((north, east), round(every_s * k * S), 1.0))
        found.append(scattered(claims, "deep"))
    return found


def test_honest_fixes_are_what_they_claim() -> None:
    by_flight = np.array([factors(1.0, 60, seed) for seed in range(40)])
    assert np.mean(by_flight == 1.0) > 0.9
    assert by_flight[:, 20:].max() < 2.0
    assert max(factors(0.5, 60)) == 1.0


def test_fixes_that_claim_a_fifth_are_found_out_within_a_second() -> None:
    assert np.mean([factors(5.0, RATE_HZ, seed)[-1] > 2.5 for seed in range(40)]) > 0.9
    assert 4.0 < factors(5.0, 40)[-1] < MOST_APART_SQUARED


def test_fixes_far_apart_in_time_are_no_neighbours() -> None:
    assert max(factors(5.0, 20, every_s=NEIGHBOURS_S + 0.1)) == 1.0


def test_one_wrong_fix_is_soon_outnumbered_and_other_methods_have_none_of_it() -> None:
    claims: tuple[Claim, ...] = ()
    found = []
    for k in range(26):
        claims = learned(claims, "deep", (0.0, 0.0), Apart((30.0 * (k == 5), 0.0), k * S // RATE_HZ, 1.0))
        found.append(scattered(claims, "deep"))
    assert found[4] == 1.0 < found[6] < MOST_APART_SQUARED / 2
    assert found[-1] < 1.5
    assert scattered(claims, "structure") == 1.0


class Hovering:
    """A vehicle that hovers beside a GNSS with noise, and fixes that err by 1 m and claim what is said."""

    def __init__(self, claim_m: float, seed: int, *, found_in_flight: bool = False) -> None:
        self.tracker, self.monitor = Tracker(CoreSettings().navigator), GnssMonitor(CoreSettings().gnss)
        self.monitor.on_vehicle(found_in_flight, AutopilotKind.ARDUPILOT)
        self.aiding = GnssAiding(CoreSettings(), self.tracker, self.monitor)
        self.tracker.set_origin(ORIGIN)
        self.rng, self.claim_m, self.t_ns = np.random.default_rng(seed), claim_m, 0
        self.fly(3.0, sees=False)
        self.tracker.seed(self.t_ns, at(np.zeros(2)), 2.0)

    def fly(self, seconds: float, *, sees: bool = True, false_by_m: float = 0.0) -> float | None:
        """How long GNSS is trusted, None: to the end."""
        begun_ns = self.t_ns
        for _ in range(round(seconds * RATE_HZ)):
            self.t_ns += S // RATE_HZ
            t_ns = self.t_ns
            self.tracker.drive(Velocity(t_ns, (0.0, 0.0, 0.0), 140.0, 0.3, Drive.AUTOPILOT), t_ns, alone=False)
            gnss_ne_m = np.array((false_by_m, 0.0)) + 0.2 * self.rng.standard_normal(2)
            self.aiding.on_gnss(Gnss(t_ns, t_ns, 3, 12, at(gnss_ne_m), 1.0, None, None), t_ns, Mode.SHADOW)
            if sees:
                self._see(t_ns)
            self.monitor.update(t_ns, EkfSource.GNSS)
            if sees and not self.monitor.trusted:
                return (t_ns - begun_ns) / S
        return None

    def _see(self, t_ns: int) -> None:
        var = self.claim_m**2
        place, cov = at(self.rng.standard_normal(2)), ((var, 0.0), (0.0, var))
        fix = Fix(t_ns, t_ns, 1, 1, "t", place, (1.0, 0.0, 0.0, 0.0), cov, 1.0, 0.1, 0.0, 1.0)
        held = self.tracker.at(t_ns)
        if isinstance(self.tracker.observe(fix), Accepted):
            self.aiding.compare(fix, held)


@pytest.mark.parametrize("found_in_flight", [False, True])
@pytest.mark.parametrize("claim_m", [0.2, 0.4, 1.0])
def test_a_good_gnss_stays_trusted_beside_fixes_that_claim_too_little(claim_m: float, found_in_flight: bool) -> None:
    flights = [Hovering(claim_m, seed, found_in_flight=found_in_flight) for seed in range(12)]
    assert [flight.fly(30.0) for flight in flights] == [None] * 12


@pytest.mark.parametrize("claim_m", [0.2, 1.0])
@pytest.mark.parametrize("sure_s", [4.0, 20.0])
def test_a_false_one_is_found_beside_them_all_the_same(claim_m: float, sure_s: float) -> None:
    for seed in range(4):
        hovering = Hovering(claim_m, seed)
        assert hovering.fly(sure_s) is None
        found_s = hovering.fly(20.0, false_by_m=25.0)
        assert found_s is not None
        assert found_s <= 4.0
