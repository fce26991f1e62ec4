"""The tables of docs/scenarios.md: what each scenario is and must show (from the library), and what it showed (from flights)."""

from __future__ import annotations

from collections.abc import Sequence

from visloc_companion.sim.scenarios import SCENARIOS, Expectation, Scenario

LIMIT_COLUMNS = ("scenario", "s", "frames/s", "what happens", "what must come out")
LIMITS, RESULTS, END = "<!-- limits -->", "<!-- results -->", "<!-- end -->"


def table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown."""
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join(f"| {' | '.join(line)} |" if line is not lines[1] else f"|{'|'.join(line)}|" for line in lines)


def replaced(page: str, begin: str, content: str) -> str:
    """The page with what stands between a mark and the next end replaced."""
    head, rest = page.split(begin, 1)
    return f"{head}{begin}\n\n{content}\n\n{END}{rest.split(END, 1)[1]}"


def limits_table() -> str:
    """What each scenario is and must show."""
    return table(LIMIT_COLUMNS, [_limits(scenario) for scenario in SCENARIOS.values()])


def _limits(scenario: Scenario) -> list[str]:
    rate = f"{scenario.frame_rate_hz:.2g}"
    return [f"`{scenario.name}`", f"{scenario.duration_s:g}", rate, scenario.summary, _in_words(scenario.expected)]


def _in_words(e: Expectation) -> str:
    parts = []
    if e.median_error_m is not None and e.max_error_m is not None:
        of_plane = "" if e.plane_max_error_m is None else f" (a plane {e.plane_max_error_m:g} m)"
        parts.append(f"error ≤ {e.median_error_m:g} m median, ≤ {e.max_error_m:g} m at most{of_plane}")
    if e.dead_reckoning_m is not None:
        parts.append(f"≤ {e.dead_reckoning_m:g} m without fixes")
    if e.verdict_within_s is not None:
        parts.append(f"GNSS bad ≤ {e.verdict_within_s:g} s")
    parts.append(f"no fix taken > {e.wrong_fix_m:g} m off")
    if e.injection_gap_s != Expectation().injection_gap_s:
        parts.append(f"gap ≤ {e.injection_gap_s:g} s")
    if e.structure_share > 0:
        parts.append(f"≥ {e.structure_share:.0%} of the fixes by structure")
    through, last = ", ".join(e.modes), " or ".join(e.final_modes)
    parts.append(f"modes {through}; at the end {last}")
    if e.final_verdicts != Expectation().final_verdicts:
        parts.append(f"verdict at the end {' or '.join(e.final_verdicts)}")
    return "; ".join(parts)
