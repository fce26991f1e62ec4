"""What flies is checked twice where the configuration asks for it."""

from __future__ import annotations

from pathlib import Path

import pytest

from visloc_companion.app.localiser import configured_localiser
from visloc_companion.app.settings import camera_model
from visloc_companion.config import CameraConfig, LocaliserConfig
from visloc_companion.localise.rolling_shutter import Unrolled
from visloc_companion.localise.twice import CheckedTwice
from visloc_companion.localise.with_motion import WithMotion
from visloc_companion.localise.with_turn import WithTurn
from visloc_companion.protocols import Localiser

MODEL = camera_model(CameraConfig())


def of_frames_set_right(localiser: Localiser) -> WithTurn:
    """Everything looks at frames that a rolling shutter no longer bends, and both computations have the prior that the turn
    carried on."""
    assert isinstance(localiser, Unrolled)
    assert isinstance(localiser._localiser, WithTurn)
    return localiser._localiser


@pytest.mark.parametrize(("every", "kind"), [(0, WithMotion), (20, CheckedTwice)])
def test_the_second_computation_is_there_where_it_is_wished_for(every: int, kind: type) -> None:
    localiser, features = configured_localiser(LocaliserConfig(method="gradient", check_every=every), MODEL)
    turning = of_frames_set_right(localiser)
    assert type(turning._localiser) is kind
    assert features is None
    assert localiser.method == "gradient"


def test_the_second_computation_has_a_network_of_its_own(network: Path) -> None:
    localiser, features = configured_localiser(LocaliserConfig(model=str(network), threads=2), MODEL)
    again = of_frames_set_right(localiser)._localiser._second._features  # type: ignore[attr-defined]
    assert features is not None
    assert again is not features
    assert again.session.run is not features.session.run
    assert (again.session.provider, again.session.threads) == ("cpu", 1)
