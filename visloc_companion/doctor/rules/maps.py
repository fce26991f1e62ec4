"""The map pack: whether it is whole, covers the flight, and fits the network."""

from __future__ import annotations

import datetime
import math
from collections.abc import Callable

from visloc_companion.doctor.facts import Facts, MapFacts
from visloc_companion.doctor.finding import Finding, Rule, amber, green, red, skipped
from visloc_companion.maps.ed25519 import SHORT
from visloc_companion.maps.registration import GOOD_M

Judge = Callable[[MapFacts, Facts], Finding]
MARGIN_M, OLD_YEARS, GRAVE_HEIGHT_M, ODD_HEIGHT_M = 150.0, 5.0, 30.0, 10.0
MUCH_EMPTY = 0.05
COARSE_M, LEAST_VALID = 2.0, 0.9


def map_rule(rule_id: str, reads: str, why: str, remedy: str) -> Callable[[Judge], Rule]:
    """Decorator: a rule about a pack that could be opened."""

    def make(judge: Judge) -> Rule:
        def check(facts: Facts) -> Finding:
            if facts.map is None or facts.map.problem:
                return skipped("no map", "give --config FILE with map.pack, and see map-opens")
            return judge(facts.map, facts)

        return Rule(rule_id, reads, why, remedy, check)

    return make


def _opens(facts: Facts) -> Finding:
    if facts.map is None:
        return skipped("no map was named", "give --config FILE with map.pack")
    return red(facts.map.problem) if facts.map.problem else green("whole, all hashes right")


@map_rule(
    "map-signature",
    "map.trusted_keys, the pack's signature",
    "Whoever can write the pack's folder can exchange the map and its hashes; the place is then wrong by as much as they like.",
    "visloc map sign PACK --key FILE where packs are built, and the .pub file in map.trusted_keys (docs/maps.md, Signatures)",
)
def _signature(found: MapFacts, facts: Facts) -> Finding:
    del facts
    if found.signature_problem:
        return red(found.signature_problem)
    return green(f"signed by {found.signed_by[:SHORT]}...") if found.signed_by else amber("none is asked for")


@map_rule(
    "map-covers-home",
    "HOME_POSITION, the pack's rectangle and its empty parts",
    "Outside the map there are no fixes.",
    "build a map that reaches further, or fly where it lies (visloc map info)",
)
def _home(found: MapFacts, facts: Facts) -> Finding:
    del facts
    if found.home_margin_m is None:
        return skipped("no home", "give --link URL, and see link-home")
    read = (
        f"home is {abs(found.home_margin_m):.0f} m " + ("inside" if found.home_margin_m >= 0 else "outside") + " the map's edge"
    )
    if found.home_margin_m < 0:
        return red(read)
    if found.home_empty:
        return red("home is where the map is empty")
    return green(read) if found.home_margin_m >= MARGIN_M else amber(read)


@map_rule(
    "map-covers-mission",
    "the mission in the autopilot, the pack's rectangle and its empty parts",
    "A way that leaves the map, or runs along its edge, is flown without fixes.",
    "visloc map check PACK --route mission.plan --margin-m 150, and a larger map or another mission",
)
def _mission(found: MapFacts, facts: Facts) -> Finding:
    if found.mission_margin_m is None:
        why = "the autopilot has no mission" if facts.link is not None and facts.link.mission == () else "no mission was read"
        return skipped(why, "give --link URL to an autopilot that holds the mission")
    margin_m = found.mission_margin_m
    read = f"the nearest place is {abs(margin_m):.0f} m " + ("inside" if margin_m >= 0 else "outside") + " the map's edge"
    if margin_m < 0:
        return red(read)
    if found.mission_empty > 0:
        read = f"{found.mission_empty:.1%} of the way is where the map is empty"
        return red(read) if found.mission_empty >= MUCH_EMPTY else amber(read)
    return green(read) if margin_m >= MARGIN_M else amber(read)


@map_rule(
    "map-datum",
    "home's height, the map's surface there",
    "Ellipsoidal heights taken for heights above sea level are tens of metres off: every footprint has the wrong size.",
    "build the pack again with the right vertical datum (visloc map build, docs/maps.md); wait for a good GNSS height",
)
def _datum(found: MapFacts, facts: Facts) -> Finding:
    del facts
    if found.height_above_surface_m is None:
        return skipped("no height of home, or no surface model", "give --link URL, and a pack with a surface model")
    read = f"home is {found.height_above_surface_m:+.1f} m above the map's surface"
    off = abs(found.height_above_surface_m)
    return green(read) if off <= ODD_HEIGHT_M else amber(read) if off <= GRAVE_HEIGHT_M else red(read)


@map_rule(
    "map-surface",
    "the pack's surface model",
    "Without one the ground is a plane: over hills fixes are off, and the structure vote has nothing.",
    "visloc map build with --dsm",
)
def _surface(found: MapFacts, facts: Facts) -> Finding:
    del facts
    return green("has a surface model") if found.has_surface else amber("has none")


@map_rule(
    "map-age",
    "the pack's capture date",
    "Houses, fields and trees change: old pictures are recognised more seldom.",
    "a newer orthophoto, or try it: visloc evaluate image on frames of the place",
)
def _age(found: MapFacts, facts: Facts) -> Finding:
    del facts
    try:
        taken = datetime.date.fromisoformat(found.capture_date)
    except ValueError:
        return amber(f"capture date {found.capture_date or 'not stated'}", "state it: visloc map build --capture-date YYYY-MM-DD")
    read = f"{found.capture_date}"
    years = (datetime.datetime.now(tz=datetime.UTC).date() - taken).days / 365.25
    return green(read) if years <= OLD_YEARS else amber(f"{read}, {years:.0f} years old")


@map_rule(
    "map-resolution",
    "the pack's ground sample distance",
    "A coarse map needs a high flight: about 170 pixels of it must lie in a frame.",
    "a finer orthophoto, or fly higher (at 60° of view 150 x the ground sample distance)",
)
def _resolution(found: MapFacts, facts: Facts) -> Finding:
    camera = facts.assumed.camera
    height_m = 170 * found.gsd_m * camera.fx_px / camera.width_px
    read = f"{found.gsd_m:.2f} m/px, good from {height_m:.0f} m above ground"
    return green(read) if found.gsd_m <= COARSE_M and math.isfinite(height_m) else amber(read)


@map_rule(
    "map-registration",
    "navigator.map_sigma_m, the pack's CRS and ground sample distance",
    "A map that lies metres beside WGS 84 puts all fixes there alike, and only map_sigma_m allows for that.",
    "compare the map with surveyed points, and state what is left as navigator.map_sigma_m (docs/maps.md, Horizontal datum)",
)
def _registration(found: MapFacts, facts: Facts) -> Finding:
    stated_m, tied_m = facts.assumed.navigator.map_sigma_m, found.crs_accuracy_m
    read = f"map_sigma_m = {stated_m:g}, {found.gsd_m:.2f} m/px"
    if tied_m is None:
        return amber(f"{read}, nobody states how well its CRS is tied to WGS 84")
    read += f", CRS tied to WGS 84 to {tied_m:g} m"
    doubtful_m = tied_m if tied_m > GOOD_M else 0.0
    return green(read) if stated_m >= max(doubtful_m, found.gsd_m) / 2 else amber(read)


@map_rule(
    "map-valid",
    "the share of pixels that the pack knows",
    "Where the map is empty there are no fixes.",
    "fill the gaps of the orthophoto, or keep the mission off them",
)
def _valid(found: MapFacts, facts: Facts) -> Finding:
    del facts
    read = f"{100 * found.share_valid:.0f} %"
    return green(read) if found.share_valid >= LEAST_VALID else amber(read)


@map_rule(
    "map-features",
    "the pack's stored features, the network",
    "Features that are not in the pack, or of another network, are computed in flight and cost time.",
    "visloc map features PACK",
)
def _features(found: MapFacts, facts: Facts) -> Finding:
    if facts.model is not None and not facts.model.needed:
        return green("this method needs none")
    return amber(found.features_missing) if found.features_missing else green("those of the network")


RULES: tuple[Rule, ...] = (
    Rule(
        "map-opens",
        "map.pack and its hashes",
        "A pack that is damaged or of another version is not flown with.",
        "what it says; visloc map build makes it again",
        _opens,
    ),
    _signature,
    _home,
    _mission,
    _datum,
    _surface,
    _age,
    _resolution,
    _registration,
    _valid,
    _features,
)
"""About the map."""
