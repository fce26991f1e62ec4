"""Configuration of a training: TOML to frozen models. Units are in the key names; an unknown key is an error."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, Field, ValidationError, model_validator

from visloc_companion.config_section import NonNegative, Positive, Section
from visloc_companion.errors import ConfigError, did_you_mean
from visloc_companion.train.config_sources import SOURCE_KINDS, SourceConfig

Count = Annotated[int, Field(ge=0)]
Whole = Annotated[int, Field(ge=1)]
UpToOne = Annotated[float, Field(ge=0, le=1)]
MAX_RANDOM_SEED = 2**31


class NetworkConfig(Section):
    """Size of the network."""

    full_width: Annotated[int, Field(ge=4, le=128)] = 16
    """Channels at full resolution."""
    half_width: Annotated[int, Field(ge=4, le=256)] = 32
    """Channels at half resolution."""
    dilations: Annotated[tuple[Whole, ...], Field(min_length=1, max_length=16)] = (1, 2, 4, 8, 4, 1)
    """One residual block for each, in pixels of the half resolution: how far the network sees."""
    descriptors: Annotated[int, Field(ge=1, le=32)] = 8
    """Learned channels beside the two of gradient orientation."""
    quarter_width: Annotated[int, Field(ge=4, le=256)] = 48
    """Channels at quarter resolution."""
    quarter_dilations: Annotated[tuple[Whole, ...], Field(max_length=16)] = ()
    """One residual block for each, in pixels of the quarter resolution; none: the network has no quarter resolution."""


class PairsConfig(Section):
    """How pairs are cut and altered; see `train/pairs.py` and `train/augment.py`."""

    reference_px: Annotated[int, Field(ge=32, le=512, multiple_of=4)] = 144
    """Side of the map piece that is searched."""
    windows_px: Annotated[tuple[Annotated[int, Field(ge=16, le=256, multiple_of=4)], ...], Field(min_length=1)] = (
        *(48, 56, 64, 80),
        100,
    )
    """Sides of the frame's raster, one of them drawn for each step."""
    footprint_share: Annotated[float, Field(gt=0.3, le=1)] = 0.8
    """Side of what the frame shows, as a share of its raster."""
    turn_deg: NonNegative = 11.0
    """The frame is turned against the map by up to this."""
    log_scale: Annotated[float, Field(ge=0, le=1)] = 0.1
    """Natural logarithm of the frame's scale against the map, at most."""
    misfit_turn_deg: NonNegative = 1.5
    """What the search's grid leaves of the turn."""
    misfit_log_scale: Annotated[float, Field(ge=0, le=1)] = 0.015
    """What the search's grid leaves of the scale."""
    misfit_tilt_deg: Annotated[float, Field(ge=0, le=30)] = 0.0
    """What is not known of the tilt, at most: the frame is laid out as if it leaned by so much less. 0 as shipped."""
    same_date_share: UpToOne = 0.05
    """Pairs of one and the same date."""
    change_share: UpToOne = 0.4
    """Pairs in which pieces of the frame are replaced by something else."""
    photometric: Annotated[float, Field(ge=0, le=2)] = 1.0
    """Strength of exchanged tones, uneven light, shadows and haze; 1 as shipped, 0 none of these."""


class ScheduleConfig(Section):
    """How long and how fast is learned (AdamW, warm-up, half a cosine)."""

    steps: Whole = 9000
    batch: Annotated[int, Field(ge=2, le=4096)] = 10
    """Pairs in a step; a neighbour's map piece serves as the wrong place, so there must be two."""
    learning_rate: Positive = 2e-3
    """Its greatest value."""
    warm_up_steps: Whole = 200
    """Steps in which it rises from zero."""
    final_share: UpToOne = 0.02
    """What is left of it at the end."""
    weight_decay: NonNegative = 1e-4
    """AdamW's, of the network's weights."""
    max_gradient_norm: Positive = 1.0
    """Longer gradients are shortened to this."""
    log_every: Whole = 50
    """Steps whose mean loss makes a line of the log."""
    check_every: Whole = 400
    """Steps between validations, each with a checkpoint and a new plot."""

    @model_validator(mode="after")
    def _in_step(self) -> ScheduleConfig:
        if self.check_every % self.log_every:
            raise ValueError(f"check_every: must be a multiple of log_every ({self.log_every})")
        return self


class ValidationConfig(Section):
    """Pairs that are never trained on, the same at every validation."""

    batch: Whole = 16
    """Pairs of each size."""
    windows_px: Annotated[tuple[Annotated[int, Field(ge=16, le=256, multiple_of=4)], ...], Field(min_length=1)] = (
        *(48, 48, 64, 64),
        *(64, 80),
    )
    """One batch for each."""
    seed: Count = 99
    sources: Annotated[tuple[SourceConfig, ...], Field(min_length=1)]
    """One validation error for each."""


class TrainingConfig(Section):
    """Everything that `visloc train features --config FILE` reads."""

    seed: Annotated[int, Field(ge=0, lt=MAX_RANDOM_SEED)] = 1
    """The first weights and all pairs follow from it."""
    threads: Whole = 2
    """Of PyTorch on the CPU; another number gives other roundings."""
    split: str = ""
    """In words: what was held out for scoring; for the model's manifest and card."""
    network: NetworkConfig = NetworkConfig()
    pairs: PairsConfig = PairsConfig()
    schedule: ScheduleConfig = ScheduleConfig()
    validation: ValidationConfig
    sources: Annotated[tuple[SourceConfig, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _fitting(self) -> TrainingConfig:
        for windows in (self.pairs.windows_px, self.validation.windows_px):
            if max(windows) > self.pairs.reference_px - 8:
                raise ValueError("windows_px: must be at least 8 px smaller than pairs.reference_px")
        for sources in (self.sources, self.validation.sources):
            if len({source.name for source in sources}) < len(sources):
                raise ValueError("sources: two have the same name")
        return self

    def plain(self) -> dict[str, Any]:
        """As plain data (lists, numbers, text): what a checkpoint holds and compares."""
        data: dict[str, Any] = json.loads(self.model_dump_json())
        return data


def load_training_config(path: Path) -> TrainingConfig:
    """Read a TOML file. Raises ConfigError naming the file, every wrong field and the remedy."""
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as why:
        raise ConfigError(f"cannot be read: {why}", where=str(path), remedy="name a readable UTF-8 TOML file") from why
    except tomllib.TOMLDecodeError as why:
        raise ConfigError(f"is not valid TOML: {why}", where=str(path), remedy="correct the line that is named") from why
    return parse_training_config(data, where=str(path))


def parse_training_config(data: dict[str, Any], where: str) -> TrainingConfig:
    """Validate plain data. Raises ConfigError with all problems at once."""
    try:
        return TrainingConfig.model_validate(data)
    except ValidationError as why:
        problems = [_explain(error) for error in _causes(why.errors())]
        raise ConfigError("; ".join(problems), where=where, remedy="see docs/training.md") from why


def _causes(errors: Sequence[Any]) -> list[Any]:
    """Without the lists that are too short only because an item of theirs is wrong."""
    places = [error["loc"] for error in errors]

    def follows(error: Any) -> bool:
        own = error["loc"]
        return error["type"] == "too_short" and any(place != own and place[: len(own)] == own for place in places)

    return [error for error in errors if not follows(error)]


def _explain(error: Any) -> str:
    location = [str(part) for part in error["loc"]]
    name = ".".join(location) or "configuration"
    if error["type"] == "missing":
        return f"{name}: is missing"
    if error["type"] in ("value_error", "union_tag_not_found"):
        return f"{name}: {error['msg'].removeprefix('Value error, ')}"
    if error["type"] != "extra_forbidden":
        return f"{name}: {error['msg']} (got {error.get('input')!r})"
    valid = _keys_at(location[:-1])
    return f"{name}: unknown key, {did_you_mean(location[-1], valid) or 'valid are ' + ', '.join(valid)}"


def _keys_at(location: list[str]) -> list[str]:
    """Valid keys of the table at a place of the configuration."""
    if "sources" in location:
        return list(SOURCE_KINDS[location[-1]].model_fields)
    model: type[BaseModel] = TrainingConfig
    for part in location:
        annotation = model.model_fields[part].annotation
        if not (isinstance(annotation, type) and issubclass(annotation, BaseModel)):
            return []
        model = annotation
    return list(model.model_fields)
