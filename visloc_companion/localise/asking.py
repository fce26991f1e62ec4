"""What localisers have in common that ask another one: about a frame that they have changed, or to add to its answer."""

from __future__ import annotations

from visloc_companion.protocols import Localiser


class Asking:
    """Holds the other localiser, and goes by its name."""

    def __init__(self, localiser: Localiser) -> None:
        self._localiser = localiser

    @property
    def method(self) -> str:
        """Name of the localiser that answers."""
        return self._localiser.method
