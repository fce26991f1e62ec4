"""Where training pairs come from: the kinds of sources of a training's configuration."""

from __future__ import annotations

from posixpath import normpath
from typing import Annotated, Literal

from pydantic import BaseModel, Field, model_validator

from visloc_companion.config_section import Positive, Section

Count = Annotated[int, Field(ge=0)]
Whole = Annotated[int, Field(ge=1)]


class Place(Section):
    """What every kind of source states."""

    name: Annotated[str, Field(min_length=1)]
    """What the source is called in logs and in the model's manifest."""
    share: Positive = 1.0
    """Weight of the source in the mixture of training pairs."""
    scales: tuple[Positive, Positive] = (0.7, 2.5)
    """Least and greatest size of a pair's pixel, in pixels of the source."""
    licence: str = "own work"
    """Licence of the imagery, for the model's manifest and card."""

    @model_validator(mode="after")
    def _ordered(self) -> Place:
        if self.scales[0] > self.scales[1]:
            raise ValueError("scales: the first must not exceed the second")
        return self


class DatesSource(Place):
    """A folder with GeoTIFFs of one place on one grid, one file a date."""

    kind: Literal["dates"]
    folder: Annotated[str, Field(min_length=1)]
    """Relative to the data folder (`--data`)."""
    first_row: Count = 0
    """Only rows from this one are used; the others stay for scoring."""
    last_row: Whole = 1_000_000
    """Only rows before this one are used."""


class PairsSource(Place):
    """A folder of folders, each with `a.tif` and `b.tif`: two dates whose shift against each other is measured."""

    kind: Literal["pairs"]
    folder: Annotated[str, Field(min_length=1)]
    """Relative to the data folder (`--data`)."""
    pairs: tuple[str, ...] = ()
    """Names of the folders to use; empty uses all."""


class LandscapeSource(Place):
    """The procedural landscape of `visloc sim`, in several seasons."""

    kind: Literal["landscape"]
    seeds: Annotated[tuple[Count, ...], Field(min_length=1)]
    """One place for each."""
    size_m: Annotated[float, Field(ge=100, le=5000)] = 600.0
    """Side of a place."""
    gsd_m: Annotated[float, Field(ge=0.1, le=5)] = 0.4
    """Size of a pixel."""
    dates: Annotated[int, Field(ge=2, le=20)] = 4
    """Seasons of each place."""


class ShapesSource(Place):
    """Invented towns and fields of flat shapes, new ones for every pair."""

    kind: Literal["shapes"]


SourceConfig = Annotated[DatesSource | PairsSource | LandscapeSource | ShapesSource, Field(discriminator="kind")]


def share_images(a: SourceConfig, b: SourceConfig) -> bool:
    """Whether two sources hold images of one place in common; invented shapes are new for every pair."""
    if isinstance(a, DatesSource) and isinstance(b, DatesSource):
        return _same(a.folder, b.folder) and max(a.first_row, b.first_row) < min(a.last_row, b.last_row)
    if isinstance(a, PairsSource) and isinstance(b, PairsSource):
        return _same(a.folder, b.folder) and (not a.pairs or not b.pairs or not set(a.pairs).isdisjoint(b.pairs))
    if isinstance(a, LandscapeSource) and isinstance(b, LandscapeSource):
        return not set(a.seeds).isdisjoint(b.seeds)
    return False


def _same(folder: str, other: str) -> bool:
    """Whether two names mean one folder of the data folder: `naip`, `naip/` and `./naip`."""
    return normpath(folder) == normpath(other)


SOURCE_KINDS: dict[str, type[BaseModel]] = {
    "dates": DatesSource,
    "pairs": PairsSource,
    "landscape": LandscapeSource,
    "shapes": ShapesSource,
}
"""By the value of `kind`."""
