"""The companion computer."""

from __future__ import annotations

from collections.abc import Callable

from visloc_companion.doctor.facts import Facts, SystemFacts
from visloc_companion.doctor.finding import Finding, Rule, amber, green, red, skipped

Judge = Callable[[SystemFacts, Facts], Finding]
LEAST_FREE_MB, TIGHT_FREE_MB, MAX_SWAP_MB, SPARE_DISK_MB = 300.0, 800.0, 200.0, 500.0
WARM_C, HOT_C = 75.0, 85.0
SLOW_GOVERNORS = ("powersave", "conservative")


def system_rule(rule_id: str, reads: str, why: str, remedy: str) -> Callable[[Judge], Rule]:
    """Decorator: a rule about this computer."""

    def make(judge: Judge) -> Rule:
        def check(facts: Facts) -> Finding:
            return (
                skipped("this computer was not read", "run it on the companion")
                if facts.system is None
                else judge(facts.system, facts)
            )

        return Rule(rule_id, reads, why, remedy, check)

    return make


@system_rule(
    "system-cores",
    "the cores that this process may use",
    "The daemon needs one, the worker another: on one core TIMESYNC waits for pictures.",
    "a computer with two cores or more; AllowedCPUs= of the unit",
)
def _cores(system: SystemFacts, facts: Facts) -> Finding:
    del facts
    return green(f"{system.cores}") if system.cores >= 2 else red(f"{system.cores}")


@system_rule(
    "system-load",
    "the load of the last minute",
    "A busy computer answers late: positions come in bursts, fixes become seldom.",
    "stop what else runs; top shows it",
)
def _load(system: SystemFacts, facts: Facts) -> Finding:
    del facts
    read = f"{system.load:.1f} on {system.cores} cores"
    return green(read) if system.load <= system.cores else amber(read)


@system_rule(
    "system-memory",
    "memory that is free",
    "Without memory the kernel kills the worker.",
    "stop what else runs, a smaller model_variant, a computer with 2 GB or more",
)
def _memory(system: SystemFacts, facts: Facts) -> Finding:
    del facts
    if system.memory_free_mb is None:
        return skipped("the system does not tell", "look with: free -m")
    read = f"{system.memory_free_mb:.0f} MB free"
    if system.memory_free_mb < LEAST_FREE_MB:
        return red(read)
    return green(read) if system.memory_free_mb >= TIGHT_FREE_MB else amber(read)


@system_rule(
    "system-swap",
    "swap in use",
    "A process that was swapped out answers seconds late, and cards wear out.",
    "more memory or fewer programs; sudo swapoff -a",
)
def _swap(system: SystemFacts, facts: Facts) -> Finding:
    del facts
    if system.swap_used_mb is None:
        return skipped("the system does not tell", "look with: free -m")
    read = f"{system.swap_used_mb:.0f} MB used"
    return green(read) if system.swap_used_mb <= MAX_SWAP_MB else amber(read)


@system_rule(
    "system-temperature",
    "the hottest thermal zone",
    "A hot processor slows down: fixes become late and seldom.",
    "airflow, a heat sink; measure again after ten minutes of work",
)
def _temperature(system: SystemFacts, facts: Facts) -> Finding:
    del facts
    if system.temperature_c is None:
        return skipped("the system does not tell", "look with: cat /sys/class/thermal/thermal_zone*/temp")
    read = f"{system.temperature_c:.0f} °C"
    return green(read) if system.temperature_c < WARM_C else amber(read) if system.temperature_c < HOT_C else red(read)


@system_rule(
    "system-governor",
    "the processor's frequency governor",
    "A slow governor answers late exactly when work comes.",
    "sudo cpupower frequency-set -g performance (or schedutil)",
)
def _governor(system: SystemFacts, facts: Facts) -> Finding:
    del facts
    if system.governor is None:
        return skipped("the system does not tell", "nothing to do on computers without frequency scaling")
    return amber(system.governor) if system.governor in SLOW_GOVERNORS else green(system.governor)


@system_rule(
    "system-bits",
    "the word size of Python",
    "The runtime of networks exists for 64 bits only, and maps do not fit into 32.",
    "a 64-bit operating system",
)
def _bits(system: SystemFacts, facts: Facts) -> Finding:
    del facts
    return green(f"{system.bits} bits") if system.bits == 64 else red(f"{system.bits} bits")


@system_rule(
    "system-clock",
    "chrony, systemd-timesyncd",
    "The calendar names journals and orders logs. Nothing in flight depends on it.",
    "sudo timedatectl set-ntp true, or chrony with the autopilot's receiver as source",
)
def _clock(system: SystemFacts, facts: Facts) -> Finding:
    del facts
    if system.clock_synchronised is None:
        return skipped("the system does not tell", "look with: timedatectl, chronyc tracking")
    return green("synchronised") if system.clock_synchronised else amber("not synchronised")


@system_rule(
    "system-serial",
    "the serial device of the link",
    "Without the right to use it there is no link at all.",
    "sudo usermod -aG dialout USER, then log in again; the unit's user is visloc",
)
def _serial(system: SystemFacts, facts: Facts) -> Finding:
    if not facts.assumed.link.url.startswith("serial:"):
        return green("the link is not a serial line")
    if not system.serial_problem:
        return green("may be used")
    remedy = "see that link.url names it (ls /dev/tty* /dev/serial/by-id), that it is plugged in, and that the port is enabled"
    return red(system.serial_problem, remedy if system.serial_problem.endswith("does not exist") else "")


@system_rule(
    "system-console",
    "the kernel's command line",
    "A console on the port mixes its output into MAVLink, and may answer.",
    "take console= of that port from the kernel's command line, and disable serial-getty on it",
)
def _console(system: SystemFacts, facts: Facts) -> Finding:
    if not facts.assumed.link.url.startswith("serial:"):
        return green("the link is not a serial line")
    if system.console_on_serial is None:
        return skipped("the system does not tell", "look with: cat /proc/cmdline")
    return red("console= names the link's port") if system.console_on_serial else green("no console on the port")


@system_rule(
    "system-journal",
    "journal.folder",
    "A flight that is not recorded cannot be explained.",
    "sudo install -d -o visloc -g visloc FOLDER, and run this as the unit's user",
)
def _journal(system: SystemFacts, facts: Facts) -> Finding:
    if facts.config is None or not facts.config.journal.folder:
        return skipped("no folder is configured", "give --config FILE, and see config-journal")
    return red(system.journal_problem) if system.journal_problem else green("can be written")


@system_rule(
    "system-disk",
    "space in journal.folder",
    "On a full disk the flight is not recorded, until there is room again.",
    "delete old journals, or let the daemon do it (journal.keep_bytes); or a smaller journal.max_bytes",
)
def _disk(system: SystemFacts, facts: Facts) -> Finding:
    if system.disk_free_mb is None:
        return skipped("no folder is configured", "give --config FILE, and see config-journal")
    needed_mb = facts.assumed.journal.max_bytes / 1e6
    read = f"{system.disk_free_mb:.0f} MB free, journal.max_bytes is {needed_mb:.0f} MB"
    if system.disk_free_mb < SPARE_DISK_MB:
        return red(read)
    return green(read) if system.disk_free_mb >= needed_mb else amber(read)


RULES: tuple[Rule, ...] = (
    _cores,
    _load,
    _memory,
    _swap,
    _temperature,
    _governor,
    _bits,
    _clock,
    _serial,
    _console,
    _journal,
    _disk,
)
"""About the computer."""
