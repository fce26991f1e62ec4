"""The link itself: what arrives, how fast, with which clock, and from whom."""

from __future__ import annotations

from collections.abc import Callable

from visloc_companion.doctor.facts import Facts, LinkFacts
from visloc_companion.doctor.finding import Finding, Rule, amber, green, red, skipped
from visloc_companion.types import AutopilotKind

Judge = Callable[[LinkFacts, Facts], Finding]
ENOUGH = 0.7
MAX_RTT_MS, GRAVE_RTT_MS, MAX_SPREAD_MS = 10.0, 50.0, 50.0
MAX_DRIFT_PPM, MAX_GARBAGE, MAX_LOST = 500.0, 0.02, 0.02
LEAST_SAMPLES, LEAST_BAUD = 5, 115_200
STATUS = {AutopilotKind.ARDUPILOT: "EKF_STATUS_REPORT", AutopilotKind.PX4: "ESTIMATOR_STATUS"}
NEEDS_POSITION = {AutopilotKind.ARDUPILOT: "LOCAL_POSITION_NED", AutopilotKind.PX4: "GLOBAL_POSITION_INT"}
"""What an autopilot sends only while its EKF has a position."""
_UNSENT = {"EKF_STATUS_REPORT": "AHRS_EKF_TYPE = 3 (ap-ekf-type): no other estimator sends it; else a faster line (921600 baud)"}


def link_rule(rule_id: str, reads: str, why: str, remedy: str) -> Callable[[Judge], Rule]:
    """Decorator: a rule about what was seen on the link."""

    def make(judge: Judge) -> Rule:
        def check(facts: Facts) -> Finding:
            return skipped("no link", "give --link URL") if facts.link is None else judge(facts.link, facts)

        return Rule(rule_id, reads, why, remedy, check)

    return make


def _stream(rule_id: str, name: str, why: str) -> Rule:
    remedy = f"a faster line (921600 baud, Ethernet), and no second program that sets the rate of {name}"

    @link_rule(rule_id, name, why, remedy)
    def rule(link: LinkFacts, facts: Facts) -> Finding:
        kind = STATUS.get(facts.autopilot, name) if name in STATUS.values() else name
        asked, got = link.asked_hz.get(kind), link.rates_hz.get(kind, 0.0)
        if asked is None:
            return skipped(f"{kind} was not asked for", "give --link URL")
        read = f"{kind} at {got:.1f} Hz of {asked:g} Hz" + (", refused at first" if kind in link.refused else "")
        if got >= ENOUGH * asked:
            return green(read)
        if got == 0 and not link.claims_position and NEEDS_POSITION.get(facts.autopilot) == kind:
            return amber(read, "wait for a position of the EKF (link-ekf-position): without one the autopilot does not send it")
        return red(read, _UNSENT.get(kind, "")) if got == 0 else amber(read)

    return rule


_SIGNS = (
    "the autopilot signs and may refuse what is not: give --config FILE with its key (link.signing_key_file, visloc link-key)"
)


@link_rule(
    "link-parameters",
    "PARAM_VALUE",
    "Rules about parameters that did not arrive cannot be judged.",
    "run it again with nothing else on the link; a slow line needs --seconds 20. Where none comes: the autopilot may refuse what "
    "is not signed (link.signing_key_file), or a router on the way drops it",
)
def _parameters(link: LinkFacts, facts: Facts) -> Finding:
    got, expected = len(facts.parameters), link.parameters_expected
    read = f"{got} of {expected or 'an unknown number of'} parameters"
    if facts.parameters_complete:
        return green(read)
    keyless = link.signed and not facts.assumed.link.signing_key_file
    return red(read, _SIGNS if keyless else "")


@link_rule(
    "link-mavlink-2",
    "the first byte of messages",
    "MAVLink 1 lacks the receiver's accuracies, gimbals and signatures.",
    "ArduPilot: SERIALn_PROTOCOL = 2 of the companion's port, then reboot the autopilot. PX4: MAV_PROTO_VER = 2",
)
def _version(link: LinkFacts, facts: Facts) -> Finding:
    del facts
    read = f"MAVLink {link.mavlink_version}"
    return green(read) if link.mavlink_version == 2 else red(read)


@link_rule(
    "link-noise",
    "bytes that are no message",
    "Noise, a wrong baud rate or a console on the port cost messages.",
    "shorter or shielded wires, the same baud rate on both sides, no console on the port",
)
def _noise(link: LinkFacts, facts: Facts) -> Finding:
    del facts
    read = f"{100 * link.garbage_share:.1f} % of the bytes"
    return green(read) if link.garbage_share <= MAX_GARBAGE else amber(read)


@link_rule(
    "link-loss",
    "the numbers of messages",
    "What is lost on the way here is lost on the way there, too: fewer positions arrive, and orders must be repeated.",
    "a wire instead of radio, a faster line (921600 baud, flow control), Ethernet that is not full",
)
def _loss(link: LinkFacts, facts: Facts) -> Finding:
    del facts
    read = f"{100 * link.lost_share:.1f} % of the messages"
    return green(read) if link.lost_share <= MAX_LOST else amber(read)


@link_rule(
    "link-baud",
    "the link's URL",
    "57600 baud does not carry attitude and accelerations at 50 Hz.",
    "link.url = serial:DEVICE:921600, and the same baud rate in the autopilot",
)
def _baud(link: LinkFacts, facts: Facts) -> Finding:
    del facts
    if not link.url.startswith("serial:"):
        return green(link.url)
    slow = int(link.url.rpartition(":")[2]) < LEAST_BAUD
    return red(link.url) if slow else green(link.url)


@link_rule(
    "link-round-trip",
    "TIMESYNC round trips",
    "PX4 believes time stamps only from exchanges of less than 10 ms; on ArduPilot half of it is the least delay of every "
    "position.",
    "a wire instead of radio, 921600 baud, USB latency timer 1 ms (setserial DEVICE low_latency), less load",
)
def _round_trip(link: LinkFacts, facts: Facts) -> Finding:
    if len(link.rtt_ms) < LEAST_SAMPLES:
        return red(f"{len(link.rtt_ms)} answers to TIMESYNC", "let TIMESYNC pass (routers drop it), and see link-noise")
    median = sorted(link.rtt_ms)[len(link.rtt_ms) // 2]
    read = f"median {median:.1f} ms, of {len(link.rtt_ms)}"
    if median <= MAX_RTT_MS:
        return green(read)
    return red(read) if median > GRAVE_RTT_MS and facts.autopilot is AutopilotKind.PX4 else amber(read)


@link_rule(
    "link-jitter",
    "TIMESYNC round trips",
    "Positions that come late in bursts are dropped, or fused as if they were younger.",
    "a link of its own for the daemon, less load on the computer, no radio",
)
def _jitter(link: LinkFacts, facts: Facts) -> Finding:
    del facts
    if len(link.rtt_ms) < LEAST_SAMPLES:
        return skipped("too few answers to TIMESYNC", "see link-round-trip")
    ordered = sorted(link.rtt_ms)
    spread = ordered[min(len(ordered) - 1, round(0.95 * len(ordered)))] - ordered[0]
    read = f"95 % within {spread:.1f} ms of the best"
    return green(read) if spread <= MAX_SPREAD_MS else amber(read)


@link_rule(
    "link-clock-drift",
    "TIMESYNC offsets",
    "Two clocks that run apart make time stamps wrong by more every second.",
    "switch off what throttles or corrects the computer's clock by leaps; a simulator must run at clock.speed",
)
def _drift(link: LinkFacts, facts: Facts) -> Finding:
    del facts
    if link.drift_ppm is None:
        return skipped("too few answers to TIMESYNC", "see link-round-trip")
    read = f"{link.drift_ppm:.0f} ± {link.drift_sigma_ppm:.0f} ppm"
    return green(read) if abs(link.drift_ppm) <= MAX_DRIFT_PPM + 3 * link.drift_sigma_ppm else amber(read)


@link_rule(
    "link-autopilot",
    "HEARTBEAT",
    "Which positions an autopilot uses, and by what parameters, is known of ArduPilot and PX4 only: nothing here tells whether "
    "another one does.",
    "an autopilot that runs ArduPilot or PX4, and the port that it speaks on itself",
)
def _autopilot(link: LinkFacts, facts: Facts) -> Finding:
    if facts.autopilot is AutopilotKind.UNKNOWN:
        return red(f"system {link.system_id} is neither ArduPilot nor PX4")
    return green(str(facts.autopilot))


@link_rule(
    "link-system",
    "the autopilot's system id",
    "The daemon listens to the configured system only.",
    "link.system_id = the autopilot's, or 0 for the first that is heard",
)
def _system(link: LinkFacts, facts: Facts) -> Finding:
    wanted = facts.assumed.link.system_id
    read = f"heard {link.system_id}, configured {wanted or 'any'}"
    return green(read) if wanted in (0, link.system_id) else red(read)


_PORT = "a port for each vehicle, and link.system_id: else the daemon keeps to the one that it hears first"


@link_rule(
    "link-second-autopilot",
    "HEARTBEATs",
    "External positions name no addressee: a second vehicle would believe them, too.",
    "a link for each vehicle, and link.system_id",
)
def _second(link: LinkFacts, facts: Facts) -> Finding:
    del facts
    others = ", ".join(f"system {number}" for number in link.other_autopilots)
    if others:
        return red(f"also {others}")
    if link.strangers:
        return amber(
            f"system {link.system_id}; {', '.join(link.strangers)} also speaks on this port and was not listened to", _PORT
        )
    return green("one autopilot")


@link_rule(
    "link-component-taken",
    "HEARTBEATs",
    "Two senders of positions on one link mix two clocks and two opinions.",
    "stop the other program (a second daemon, a VIO bridge), or give this one another link.component_id",
)
def _taken(link: LinkFacts, facts: Facts) -> Finding:
    own = facts.assumed.link.component_id
    taken = (link.system_id, own) in link.others
    return amber(f"component {own} is on the link already") if taken else green(f"component {own} is free")


@link_rule(
    "link-disarmed",
    "HEARTBEATs",
    "In flight the rates that are asked for here mix with those that the daemon asks for.",
    "run it before arming, with the daemon stopped",
)
def _disarmed(link: LinkFacts, facts: Facts) -> Finding:
    flying = link.armed and (link.system_id, facts.assumed.link.component_id) in link.others
    if flying:
        return amber("armed, and the daemon is on the link")
    return green("armed, and no daemon is on the link" if link.armed else "disarmed")


RULES: tuple[Rule, ...] = (
    _parameters,
    _version,
    _noise,
    _loss,
    _baud,
    _round_trip,
    _jitter,
    _drift,
    _stream("link-attitude-rate", "ATTITUDE", "Frames are placed by the attitude at their time."),
    _stream("link-imu-rate", "SCALED_IMU", "Accelerations carry the position between fixes while GNSS is not trusted."),
    _stream("link-global-rate", "GLOBAL_POSITION_INT", "The autopilot's position and height begin every search."),
    _stream("link-local-rate", "LOCAL_POSITION_NED", "The autopilot's velocity carries the filter while GNSS is trusted."),
    _stream("link-gnss-rate", "GPS_RAW_INT", "GNSS is judged by it."),
    _stream("link-status-rate", "EKF_STATUS_REPORT", "Whether the autopilot rejects positions is seen nowhere else."),
    _autopilot,
    _system,
    _second,
    _taken,
    _disarmed,
)
"""About the link."""
