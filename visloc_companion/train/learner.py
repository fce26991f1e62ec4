"""What learns: network, sharpness of the search's softmax, optimiser; made fresh from a seed or taken from a checkpoint."""

from __future__ import annotations

import math
import platform
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from visloc_companion.errors import ConfigError, ModelError
from visloc_companion.train.checkpoint import Ancestor, load_checkpoint
from visloc_companion.train.config import NetworkConfig, ScheduleConfig, TrainingConfig, parse_training_config
from visloc_companion.train.networks import FeatureNetwork, NetworkSettings

FIRST_LOG_SHARPNESS = 4.0
AND_THEN = ", then "
SAME_WIDTHS = "give network.full_width, half_width, dilations and descriptors of that run; only a quarter resolution may be added"


@dataclass(frozen=True, slots=True, eq=False)
class Learner:
    """What changes from step to step."""

    network: FeatureNetwork
    log_sharpness: Tensor
    optimiser: torch.optim.Optimizer


def new_learner(config: TrainingConfig, device: torch.device) -> Learner:
    """First weights from the seed, the same on every device."""
    torch.manual_seed(config.seed)
    network = FeatureNetwork(network_settings(config.network)).to(device)
    log_sharpness = torch.tensor(FIRST_LOG_SHARPNESS, device=device, requires_grad=True)
    groups: list[dict[str, Any]] = [
        {"params": network.parameters(), "weight_decay": config.schedule.weight_decay},
        {"params": [log_sharpness], "weight_decay": 0.0},
    ]
    return Learner(network, log_sharpness, torch.optim.AdamW(groups, config.schedule.learning_rate))


def network_settings(config: NetworkConfig) -> NetworkSettings:
    """The network's own settings."""
    return NetworkSettings(
        config.full_width,
        config.half_width,
        config.dilations,
        config.descriptors,
        config.quarter_width,
        config.quarter_dilations,
    )


def learning_rate(schedule: ScheduleConfig, step: int) -> float:
    """Rate of the step with this number (the first is 0): a linear rise times half a cosine down to a remainder."""
    rise = min(1.0, (step + 1) / schedule.warm_up_steps)
    fall = 0.5 * (1 + math.cos(math.pi * step / schedule.steps))
    return schedule.learning_rate * rise * (fall * (1 - schedule.final_share) + schedule.final_share)


@dataclass(frozen=True, slots=True, eq=False)
class Beginning:
    """Where a run begins: the learner, the steps and seconds that are behind it, the runs that its first weights came from, the
    checksums of the images that it saw so far (empty: none, or not known), and what it was computed on so far."""

    learner: Learner
    step: int = 0
    seconds: float = 0.0
    ancestors: tuple[Ancestor, ...] = ()
    images: Mapping[str, int] = field(default_factory=dict)
    hardware: str = ""


def begun(config: TrainingConfig, path: Path, device: torch.device, first: Path | None = None) -> Beginning:
    """As the checkpoint at `path` left it; where there is none, with the weights of the checkpoint `first`, or fresh ones.

    What a smaller network of `first` has no weights for begins fresh. Raises ConfigError for a checkpoint of another
    configuration or with other ancestors, ModelError for one that cannot be used.
    """
    learner = new_learner(config, device)
    ancestors = _taken_over(learner, first) if first is not None else ()
    if not path.exists():
        return Beginning(learner, ancestors=ancestors)
    saved = load_checkpoint(path)
    if first is not None and tuple(saved.ancestors) != ancestors:
        raise ConfigError(
            "holds a run that began with other weights",
            where=str(path.parent),
            remedy="name another folder for --out, or the same --from as when it was begun",
        )
    before = parse_training_config(saved.config, where=str(path)).plain()  # with what keys mean that came later
    if differing := _differences(before, config.plain()):
        raise ConfigError(
            f"holds a run of another configuration ({', '.join(differing)})",
            where=str(path.parent),
            remedy="name another folder for --out, or give that run's configuration to go on with it",
        )
    try:
        learner.network.load_state_dict(saved.network)
        learner.optimiser.load_state_dict(saved.optimiser)
        with torch.no_grad():
            learner.log_sharpness.copy_(saved.log_sharpness)
        torch.set_rng_state(saved.random)
    except (RuntimeError, ValueError, KeyError, TypeError) as why:
        raise ModelError("does not fit this version's network", where=str(path), remedy="train into another folder") from why
    return Beginning(learner, saved.step, saved.seconds, tuple(saved.ancestors), saved.images, saved.hardware)


def require_same_images(before: Mapping[str, int], now: Mapping[str, int], where: Path, remedy: str) -> None:
    """Raises ConfigError for folders whose images are others than those of a run (empty: not known) with the same names."""
    if before and (differing := _differences(before, now)):
        raise ConfigError(f"holds a run on other images ({', '.join(differing)})", where=str(where), remedy=remedy)


def _taken_over(learner: Learner, first: Path) -> tuple[Ancestor, ...]:
    """Copy the weights of a finished or broken-off run into the learner; that run and its own ancestors."""
    saved = load_checkpoint(first)
    try:
        lacking = learner.network.load_state_dict(saved.network, strict=False)
        with torch.no_grad():
            learner.log_sharpness.copy_(saved.log_sharpness)
    except (RuntimeError, ValueError, KeyError, TypeError) as why:
        raise ModelError("does not fit the configuration's network", where=str(first), remedy=SAME_WIDTHS) from why
    if lacking.unexpected_keys or not all(key.startswith("quarter.") for key in lacking.missing_keys):
        raise ModelError("does not fit the configuration's network", where=str(first), remedy=SAME_WIDTHS)
    return (*saved.ancestors, Ancestor(saved.config, saved.step, saved.seconds, saved.hardware))


def _differences(a: Mapping[str, Any], b: Mapping[str, Any], prefix: str = "") -> list[str]:
    """Dotted names of the keys whose values differ."""
    names: list[str] = []
    for key in dict.fromkeys([*a, *b]):
        left, right = a.get(key), b.get(key)
        if isinstance(left, dict) and isinstance(right, dict):
            names += _differences(left, right, f"{prefix}{key}.")
        elif left != right:
            names.append(prefix + key)
    return names


def checked_device(name: str) -> torch.device:
    """`cpu`, `cuda`, `cuda:1`. Raises ConfigError for one that is not there."""
    try:
        device = torch.device(name)
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError, NotImplementedError) as why:
        raise ConfigError(
            f"{name!r} cannot be used: {str(why).splitlines()[0]}", where="--device", remedy="cpu, or a PyTorch built for the GPU"
        ) from why
    return device


def hardware(device: torch.device, threads: int) -> str:
    """What a run was computed on, in words."""
    if device.type == "cuda":
        return str(torch.cuda.get_device_name(device))
    return f"CPU ({platform.machine()}), {threads} threads"


def on_all(*hardware: str) -> str:
    """What several sittings were computed on, each once, in their order; empty ones are not known."""
    return AND_THEN.join(dict.fromkeys(one for some in hardware for one in some.split(AND_THEN) if one))
