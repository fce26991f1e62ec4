"""From the section `localiser` of the configuration to what localises: the same in flight, in a re-run and in simulation."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from visloc_companion.app.settings import network_choice
from visloc_companion.config import LocaliserConfig
from visloc_companion.geo.pinhole_view import pinhole_view
from visloc_companion.localise.around.map_shape import OverPlane
from visloc_companion.localise.around.rectified import behind_the_lens
from visloc_companion.localise.around.rolling_shutter import Unrolled
from visloc_companion.localise.around.still_picture import MovingFramesOnly
from visloc_companion.localise.around.twice import CheckedTwice
from visloc_companion.localise.around.with_motion import WithMotion
from visloc_companion.localise.around.with_turn import WithTurn
from visloc_companion.localise.around.zoomed import Zoomed
from visloc_companion.localise.features.onnx import NetworkFeatures
from visloc_companion.localise.flight import flight_localiser
from visloc_companion.localise.mapped.map_light import MapLight
from visloc_companion.localise.masked import behind_the_mask
from visloc_companion.localise.odometry.surface_window import SurfaceWindow
from visloc_companion.localise.odometry.true_heading import TrueHeading
from visloc_companion.localise.registry import make_localiser, open_features_for
from visloc_companion.localise.runtime import default_threads
from visloc_companion.protocols import Localiser
from visloc_companion.types import CameraModel


def configured_localiser(chosen: LocaliserConfig, model: CameraModel) -> tuple[Localiser, NetworkFeatures | None]:
    """The localiser that flies, and the network's features that it looks through, where its method needs them.

    Raises ConfigError for a method that there is not, ModelError where the network cannot be used.
    """
    features = open_features_for(chosen.method, network_choice(chosen))
    light = MapLight()  # whatever lens a frame is looked at through, it is the same map's
    as_calibrated = behind_the_mask(lambda shown: _of_ground(chosen, shown, features, light), model)

    def made_for(other: CameraModel, **less: object) -> Localiser:
        """For an enlarged picture; a check by another network would be opened for each enlargement."""
        like_it = chosen.model_copy(update={"check_every": 0, **less})
        return behind_the_mask(lambda shown: _of_ground(like_it, shown, features, light), other)

    tries_for = partial(made_for, odometry=False, structure=False)
    return Zoomed(as_calibrated, made_for, tries_for, model), features


def _of_ground(chosen: LocaliserConfig, model: CameraModel, features: NetworkFeatures | None, light: MapLight) -> Localiser:
    """The localiser of frames that show nothing but ground where the model's mask does not say otherwise."""
    view = pinhole_view(model)
    localiser = flight_localiser(
        chosen.method,
        view,
        features,
        max_probability_wrong=chosen.max_probability_wrong,
        max_search_radius_m=chosen.max_search_radius_m,
        threads=chosen.threads or default_threads(),
        structure=chosen.structure,
        light=light,
    )
    window, heading = SurfaceWindow(), TrueHeading()  # turn and motion are seen over the same ground, under the same heading
    moving: Localiser = WithMotion(localiser, view, window=window, heading=heading) if chosen.odometry else localiser
    checked = CheckedTwice(moving, _again(chosen, view), chosen.check_every) if chosen.check_every else moving
    seen = Unrolled(behind_the_lens(OverPlane(WithTurn(checked, view, window, heading)), model), model)
    return MovingFramesOnly(seen, model)


def _again(chosen: LocaliserConfig, model: CameraModel) -> Localiser:
    """The image's localiser once more, with nothing of the first one's: what its fixes are checked by."""
    network = replace(network_choice(chosen), providers=("cpu",), threads=1)
    return make_localiser(
        chosen.method,
        model,
        features=open_features_for(chosen.method, network),
        max_probability_wrong=chosen.max_probability_wrong,
        max_search_radius_m=chosen.max_search_radius_m,
    )
