"""The daemon's configuration against itself and the autopilot. (What is wrong in itself is refused when it is read.)"""

from __future__ import annotations

from collections.abc import Callable

from visloc_companion.config import LEAST_REPORTS, Config
from visloc_companion.doctor.facts import Facts
from visloc_companion.doctor.finding import Finding, Rule, amber, green, red, skipped
from visloc_companion.doctor.rules.parameter import unread
from visloc_companion.types import AutopilotKind

Judge = Callable[[Config, Facts], Finding]
COMPONENT = 197
PX4_LEAST_HZ, LEAST_ATTITUDE_HZ = 8.0, 20.0


def config_rule(rule_id: str, reads: str, why: str, remedy: str, only: AutopilotKind | None = None) -> Callable[[Judge], Rule]:
    """Decorator: a rule about a configuration."""

    def make(judge: Judge) -> Rule:
        def check(facts: Facts) -> Finding:
            return skipped("no configuration", "give --config FILE") if facts.config is None else judge(facts.config, facts)

        return Rule(rule_id, reads, why, remedy, check, only)

    return make


@config_rule(
    "config-output-rate",
    "navigator.output_rate_hz",
    "PX4 begins to fuse after two samples within 200 ms and stops after a gap of 400 ms: near 5 Hz one late sample is enough.",
    "navigator.output_rate_hz = 10",
    AutopilotKind.PX4,
)
def _output_rate(config: Config, facts: Facts) -> Finding:
    del facts
    read = f"{config.navigator.output_rate_hz:g} Hz"
    return green(read) if config.navigator.output_rate_hz >= PX4_LEAST_HZ else red(read)


@config_rule(
    "config-source-sets",
    "injection.gnss_source_set injection.vision_source_set",
    "One set cannot be both: switching would do nothing.",
    "injection.gnss_source_set = 1, injection.vision_source_set = 2",
    AutopilotKind.ARDUPILOT,
)
def _sets(config: Config, facts: Facts) -> Finding:
    del facts
    read = f"{config.injection.gnss_source_set} and {config.injection.vision_source_set}"
    return red(read) if config.injection.gnss_source_set == config.injection.vision_source_set else green(read)


@config_rule(
    "config-gnss-control",
    "injection.px4_gps_ctrl",
    "0 would leave GNSS off when it is trusted again.",
    "injection.px4_gps_ctrl = 7",
    AutopilotKind.PX4,
)
def _gps_ctrl(config: Config, facts: Facts) -> Finding:
    del facts
    read = f"{config.injection.px4_gps_ctrl}"
    return green(read) if config.injection.px4_gps_ctrl & 1 else red(read)


@config_rule(
    "config-policy",
    "injection.policy",
    "`never` sends nothing. `always` sends while GNSS is good, too, and PX4 then fuses positions minus a bias.",
    'injection.policy = "when_unreliable"',
)
def _policy(config: Config, facts: Facts) -> Finding:
    del facts
    read = config.injection.policy
    return green(read) if read == "when_unreliable" else amber(read)


@config_rule(
    "config-min-sigma",
    "injection.min_sigma_m",
    "Ten positions a second rest on few fixes: a small claim makes the autopilot believe them too much.",
    "injection.min_sigma_m = 0.5",
)
def _min_sigma(config: Config, facts: Facts) -> Finding:
    del facts
    read = f"{config.injection.min_sigma_m:g} m"
    return green(read) if 0.3 <= config.injection.min_sigma_m <= 10 else amber(read)


@config_rule(
    "config-clock", "clock.speed", "Anything but 1 is for simulators: on a vehicle every time is wrong.", "clock.speed = 1"
)
def _speed(config: Config, facts: Facts) -> Finding:
    del facts
    read = f"{config.clock.speed:g}"
    return green(read) if config.clock.speed == 1 else red(read)


@config_rule(
    "config-journal",
    "journal.folder",
    "A flight that is not recorded cannot be explained.",
    'journal.folder = "/var/lib/visloc/journals"',
)
def _journal(config: Config, facts: Facts) -> Finding:
    del facts
    return green(config.journal.folder) if config.journal.folder else amber("empty")


@config_rule(
    "config-component",
    "link.component_id",
    "PX4 counts heartbeats of component 197 as the vision system's; ground stations name it.",
    "link.component_id = 197",
)
def _component(config: Config, facts: Facts) -> Finding:
    del facts
    read = f"{config.link.component_id}"
    if config.link.component_id == 1:
        return red(f"{read}: the autopilot's own")
    return green(read) if config.link.component_id == COMPONENT else amber(read)


@config_rule(
    "config-attitude-rate",
    "link.attitude_rate_hz",
    "A frame is placed by the attitudes about it: with few of them turns stay unseen.",
    "link.attitude_rate_hz = 50",
)
def _attitude(config: Config, facts: Facts) -> Finding:
    del facts
    read = f"{config.link.attitude_rate_hz:g} Hz"
    return green(read) if config.link.attitude_rate_hz >= LEAST_ATTITUDE_HZ else amber(read)


@config_rule(
    "config-gnss-rate",
    "link.gnss_rate_hz gnss.silence_s",
    "A receiver that says nothing for gnss.silence_s is lost: where that holds fewer than three reports one that the line drops "
    "does it, and positions are sent beside a good GNSS.",
    "link.gnss_rate_hz = 5, gnss.silence_s = 2",
)
def _gnss_rate(config: Config, facts: Facts) -> Finding:
    del facts
    held = config.link.gnss_rate_hz * config.gnss.silence_s
    read = f"{config.link.gnss_rate_hz:g} Hz for {config.gnss.silence_s:g} s: {held:.3g} reports"
    if held < LEAST_REPORTS:
        return red(read)
    return green(read) if held >= LEAST_REPORTS + 1 else amber(read)


@config_rule(
    "config-hashes",
    "map.verify_hashes",
    "A damaged pack, or one that was exchanged, is then not noticed.",
    "map.verify_hashes = true",
)
def _hashes(config: Config, facts: Facts) -> Finding:
    del facts
    return green("true") if config.map.verify_hashes else amber("false")


@config_rule(
    "config-lost-sigma",
    "navigator.lost_sigma_m",
    "Beyond it injection stops. A large value lets the vehicle fly on a guess; a small one ends every gap.",
    "navigator.lost_sigma_m = 60",
)
def _lost(config: Config, facts: Facts) -> Finding:
    del facts
    read = f"{config.navigator.lost_sigma_m:g} m"
    return green(read) if 20 <= config.navigator.lost_sigma_m <= 120 else amber(read)


@config_rule(
    "config-camera",
    "camera.url localiser.terrain",
    "Without a camera, or a rangefinder over a surface model, there is nothing that could give fixes.",
    "camera.url, or localiser.terrain = true",
)
def _camera(config: Config, facts: Facts) -> Finding:
    del facts
    if config.camera.url or config.localiser.terrain:
        return green(config.camera.url or "terrain")
    return amber("neither is set")


@config_rule(
    "config-output",
    "injection.output, the autopilot's parameters",
    "A message that the autopilot does not take is not sent at all.",
    'injection.output = "auto"',
)
def _output(config: Config, facts: Facts) -> Finding:
    choice = facts.choice
    if not facts.parameters:
        return unread(facts, f"the autopilot, which injection.output = {config.injection.output} depends on")
    return red(choice.why, choice.remedy) if choice.output is None else green(str(choice))


_SAME_KEY = "give the autopilot the passphrase of that file (docs/safety.md, Somebody on the link), or name the file with its key"


@config_rule(
    "config-signing",
    "link.signing_key_file, signatures of the autopilot",
    "With a key on one side only, everything that the other sends is refused.",
    "the same key on both sides (visloc link-key), or none; or link.accept_unsigned",
)
def _signing(config: Config, facts: Facts) -> Finding:
    if facts.link is None:
        return skipped("no link", "give --link URL")
    key, signed = bool(config.link.signing_key_file), facts.link.signed
    if facts.link.another_key:
        return red("the autopilot signs with another key than that of link.signing_key_file", _SAME_KEY)
    read = f"{'a key' if key else 'no key'}, the autopilot {'signs' if signed else 'does not sign'}"
    if key == signed or (key and config.link.accept_unsigned):
        return green(read)
    return red(read) if key else amber(read)


RULES: tuple[Rule, ...] = (
    _output,
    _signing,
    _output_rate,
    _sets,
    _gps_ctrl,
    _policy,
    _min_sigma,
    _speed,
    _journal,
    _component,
    _attitude,
    _gnss_rate,
    _hashes,
    _lost,
    _camera,
)
"""About the configuration."""
