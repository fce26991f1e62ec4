"""Losing and regaining trust: signs must last, probation must be clean, and after a disagreement only vision restores it."""

from __future__ import annotations

from visloc_companion.core.settings import GnssSettings
from visloc_companion.types import Verdict

VISION_AGE_S = 5.0
"""Vision counts as present while its last comparison is younger."""
TRUSTED_BELOW = 0.05
"""A GNSS comes back only when it is false with less than this probability."""
HOLD_DENIED_S = 15.0
"""DENIED stands through the first part of a probation, so that a GNSS that comes and goes does not fill the screen."""
DENYING = ("no_data", "silence", "no_fix", "few_satellites")
"""Reasons that mean there is no position at all; every other reason makes it suspect."""
AT_ONCE = ("silence", "no_data")
"""These have waited by themselves."""


class Trust:
    """Whether GNSS is trusted, and since when nothing speaks against it."""

    def __init__(self, settings: GnssSettings) -> None:
        self._settings = settings
        self._since_ns: dict[str, int] = {}
        self._clean_since_ns: int | None = None
        self._denying_ns: int | None = None
        self.trusted = self.ever = self.returned = False

    @property
    def signs(self) -> bool:
        """Whether any sign is there, lasting or not."""
        return bool(self._since_ns)

    def lasting(self, now_ns: int, signs: tuple[str, ...]) -> tuple[str, ...]:
        """The signs that have been there for `denied_after_s`; any sign ends the clean time."""
        if not signs:
            self._since_ns = {}
            return ()
        self._since_ns = {sign: self._since_ns.get(sign, now_ns) for sign in signs}
        self.interrupt()
        after_ns = self._settings.denied_after_s * 1e9
        return tuple(s for s in signs if s in AT_ONCE or now_ns - self._since_ns[s] >= after_ns)

    def interrupt(self) -> None:
        """Something spoke against GNSS: a probation starts anew."""
        self._clean_since_ns = None

    def lose(self) -> None:
        """GNSS is trusted no longer."""
        self.trusted = self.returned = False
        self.interrupt()

    def begin(self, now_ns: int) -> None:
        """Nothing speaks against GNSS now: the clean time runs."""
        if self._clean_since_ns is None:
            self._clean_since_ns = now_ns

    def earned(self, now_ns: int, probability_false: float, need_s: float, *, returns: bool) -> bool:
        """Trust after enough clean time, and when the tests find it true; `returns`: it came through a probation that brings a
        vehicle back to it. Returns whether it is given."""
        clean_ns = 0 if self._clean_since_ns is None else now_ns - self._clean_since_ns
        if self._clean_since_ns is None or clean_ns < need_s * 1e9 or probability_false >= TRUSTED_BELOW:
            return False
        self.trusted = self.ever = True
        self.returned = returns
        return True

    def verdict(self, now_ns: int, reasons: tuple[str, ...]) -> Verdict:
        """OK, SUSPECT or DENIED of the reasons that stand."""
        if any(reason in DENYING for reason in reasons):
            self._denying_ns = now_ns
        if self.trusted:
            self._denying_ns = None
            return Verdict.OK
        held = self._denying_ns is not None and now_ns - self._denying_ns < HOLD_DENIED_S * 1e9
        held = held and all(reason in DENYING or reason == "probation" for reason in reasons)
        denying = self._denying_ns == now_ns
        return Verdict.DENIED if denying or held or not self.ever else Verdict.SUSPECT
