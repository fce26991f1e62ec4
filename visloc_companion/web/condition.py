"""Health of the daemon's parts, what it sends, and what the operator was told, out of a snapshot."""

from __future__ import annotations

from typing import Any

from visloc_companion.web.reading import count, flag, number, part, text, texts
from visloc_companion.web.words import span

PARTS = ("link", "camera", "worker", "tick")
FRAME_LATE_S = 5.0
HOT_C = 85.0
"""Small computers slow down beyond it."""
SPARE_BYTES = 500e6
"""Less than this on the journal's disk is as good as full."""
MAX_NOTICES = 8
NOT_KNOWN = "not known"
SEVERITIES = ("info", "notice", "warning", "critical")


def injection(snapshot: dict[str, Any]) -> dict[str, Any]:
    """Whether positions go to the autopilot now, why those that should do not, and how many have; of a journal, which does not
    say what went out, how many were `given` to be sent."""
    sent = part(snapshot, "injections")
    injected = flag(part(snapshot, "status").get("injected"))
    says = {True: "sending positions to the autopilot", False: "not sending", None: "not known"}[injected]
    withheld = text(sent.get("withheld")) if injected else ""
    if withheld:
        injected, says = False, f"positions are NOT SENT: {withheld}"
    sums = {name: count(sent.get(name)) for name in ("sent", "dropped")}
    given = {"given": count(sent["given"])} if "given" in sent else {}
    return {"now": injected, "says": says, "withheld": withheld, **sums, **given}


def line(snapshot: dict[str, Any]) -> dict[str, Any]:
    """Whether the line to the autopilot is too slow for what is sent, and how many messages were left out for that."""
    told = part(snapshot, "line")
    return {"slow": flag(told.get("slow")), "left_out": count(told.get("left_out"))}


def health(snapshot: dict[str, Any]) -> list[dict[str, Any]]:
    """One row a part: name, `ok` (None: there is none, or it is not known) and what to say."""
    hanging = set(texts(snapshot.get("late"), len(PARTS)))
    rows = [
        _row("link", *_link(snapshot)),
        _row("camera", *_camera(snapshot)),
        _row("worker", *_worker(snapshot)),
        _row("disk", *_disk(snapshot)),
    ]
    if computer := part(snapshot, "computer"):
        rows.append(_row("computer", *_computer(computer)))
    if "tick" in hanging:
        rows.append(_row("tick", False, "hangs"))
    return [_row(row["part"], False, f"hangs; {row['says']}") if row["part"] in hanging and row["ok"] else row for row in rows]


def notices(snapshot: dict[str, Any]) -> list[dict[str, Any]]:
    """The last texts that went to the operator (STATUSTEXT), newest first."""
    found = snapshot.get("notices")
    rows = [item for item in found if isinstance(item, dict)] if isinstance(found, list) else []
    return [
        {"text": text(row.get("text")), "severity": _severity(row.get("severity")), "age_s": number(row.get("age_s"), 0.0)}
        for row in rows[:MAX_NOTICES]
    ]


def _severity(value: object) -> str:
    return value if isinstance(value, str) and value in SEVERITIES else "info"


def _row(name: str, ok: bool | None, says: str) -> dict[str, Any]:
    return {"part": name, "ok": ok, "says": says}


def _link(snapshot: dict[str, Any]) -> tuple[bool | None, str]:
    up, autopilot = flag(snapshot.get("link_up")), part(snapshot, "autopilot")
    if not up:
        return up, "no autopilot answers" if up is False else NOT_KNOWN
    name = {"ardupilot": "ArduPilot", "px4": "PX4"}.get(text(autopilot.get("kind")), "an autopilot")
    armed = {True: "armed", False: "disarmed", None: "armed or not is not known"}[flag(autopilot.get("armed"))]
    version = text(autopilot.get("version"))
    says = f"{name} {version}, {armed}" if version else f"{name}, {armed}"
    carried = line(snapshot)
    if carried["slow"]:
        return False, f"the line is too slow, {carried['left_out'] or 0} messages were left out; {says}"
    return True, says


def _camera(snapshot: dict[str, Any]) -> tuple[bool | None, str]:
    age_s = number(snapshot.get("frame_age_s"), 0.0)
    if flag(snapshot.get("camera")) is False:
        return None, "none configured"
    if age_s is None:
        return (False, "no frame yet") if "camera" in snapshot else (None, NOT_KNOWN)
    return age_s <= FRAME_LATE_S, f"last frame {span(age_s)} ago"


def _worker(snapshot: dict[str, Any]) -> tuple[bool | None, str]:
    worker = part(snapshot, "worker")
    if not worker:
        return None, "none: nothing is localised" if "worker" in snapshot else NOT_KNOWN
    restarts = count(worker.get("restarts")) or 0
    again = f"; {restarts} restarts in the last minute" if restarts else ""
    if flag(worker.get("given_up")):
        return False, f"died too often, tried again each minute{again}"
    return (True, f"up{again}") if flag(worker.get("up")) else (False, f"down{again}")


def _disk(snapshot: dict[str, Any]) -> tuple[bool | None, str]:
    journal = part(snapshot, "journal")
    if not journal:
        return None, "no journal is written" if "journal" in snapshot else NOT_KNOWN
    dropped, problem = count(journal.get("dropped")) or 0, text(journal.get("problem"))
    if problem:
        return False, problem
    used, total = _used_of(part(snapshot, "computer"), "storage")
    free = None if used is None or total is None else total - used
    room = "" if free is None else f", {free / 1e9:.1f} GB free"
    if dropped:
        return False, f"journal lacks {dropped} records{room}"
    return free is None or free >= SPARE_BYTES, f"journal is written{room}"


def _computer(load: dict[str, Any]) -> tuple[bool | None, str]:
    found = load.get("cores")
    cores = [share for core in found if (share := number(core, 0.0, 1.0)) is not None] if isinstance(found, list) else []
    used, total = _used_of(load, "ram")
    celsius = number(load.get("temperature_c"))
    says = [f"{100 * sum(cores) / len(cores):.0f} % of {len(cores)} cores"] if cores else []
    if used is not None and total is not None:
        says.append(f"{used / 1e9:.1f} of {total / 1e9:.1f} GB memory")
    if celsius is not None:
        says.append(f"{celsius:.0f} °C")
    return None if celsius is None else celsius < HOT_C, ", ".join(says) or NOT_KNOWN


def _used_of(load: dict[str, Any], what: str) -> tuple[int | None, int | None]:
    return count(load.get(f"{what}_used_bytes")), count(load.get(f"{what}_total_bytes"))
