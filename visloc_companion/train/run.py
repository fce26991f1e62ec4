"""A training run: deterministic by its configuration, broken off and resumed at will, watched while it goes.

Pairs follow from the seed and the step alone (train/steps.py), so a checkpoint need not hold any state of theirs.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Protocol

import cv2
import torch
from torch import nn

from visloc_companion.errors import ModelError
from visloc_companion.train.ahead import batches_ahead
from visloc_companion.train.checkpoint import Checkpoint, save_checkpoint, write_file
from visloc_companion.train.config import TrainingConfig
from visloc_companion.train.curves import curves_svg
from visloc_companion.train.learner import Beginning, begun, checked_device, hardware, learning_rate, on_all, require_same_images
from visloc_companion.train.log import RunLog
from visloc_companion.train.mixture import Places, pair_settings, training_sources, validation_batches
from visloc_companion.train.run_folder import run_folder
from visloc_companion.train.steps import Batch, make_batch, training_loss, validate

CHECKPOINT, LOG, CURVES = "checkpoint.pt", "log.jsonl", "curves.svg"
OTHER_IMAGES = "give the images that it was begun with (--data), or name another folder for --out"


class Watcher(Protocol):
    """Who is told what goes on."""

    def preparing(self, what: str) -> None:
        """A source is being opened or made."""
        ...

    def stepped(self, step: int, steps: int, loss: float, seconds_per_step: float) -> None:
        """A step is done; `loss` is the mean since the last line of the log."""
        ...

    def validated(self, step: int, wrong: Mapping[str, float], gradient_wrong: Mapping[str, float]) -> None:
        """Share of validation queries placed wrong, by source; and of plain gradient features."""
        ...


def train(
    config: TrainingConfig,
    data: Path,
    out: Path,
    watcher: Watcher,
    device_name: str = "cpu",
    first: Path | None = None,
    workers: int = 0,
) -> Path:
    """Train, or go on where `out` holds a checkpoint of the same configuration; the path of the last checkpoint.

    `data` is the folder that the sources' folders lie in; `first` a checkpoint whose weights to begin with;
    `workers` processes make pairs (0: a thread). Writes `checkpoint.pt`, `log.jsonl` and `curves.svg` as it goes.
    Raises ConfigError (missing data, full disk, a run of another configuration, other images or another process in `out`, a lost
    process), CasesError (images that cannot be used), ModelError (damaged checkpoint, figures that are not finite).
    """
    device = checked_device(device_name)
    torch.set_num_threads(config.threads)
    cv2.setNumThreads(1)
    with run_folder(out):
        return _trained(config, data, out, watcher, device, first, workers)


def _trained(
    config: TrainingConfig,
    data: Path,
    out: Path,
    watcher: Watcher,
    device: torch.device,
    first: Path | None,
    workers: int,
) -> Path:
    beginning = begun(config, out / CHECKPOINT, device, first)
    start = beginning.step
    places, settings = Places(data, watcher.preparing), pair_settings(config.pairs)
    sources = training_sources(config, places)
    watcher.preparing("validation pairs")
    checks = validation_batches(config.validation, settings, places)
    require_same_images(beginning.images, places.images, out, OTHER_IMAGES)
    run = _Run(config, beginning, places.images, checks, RunLog(out / LOG, start), out, watcher)
    if start == 0:
        run.baseline()

    def batch_of(step: int) -> Batch:
        return make_batch([config.seed, step], sources, settings, config.schedule.batch)

    for step, batch in batches_ahead(batch_of, start, config.schedule.steps, workers):
        run.step(step, _moved(batch, device))
    return out / CHECKPOINT


class _Run:
    """Steps, lines of the log, validations, checkpoints."""

    def __init__(
        self,
        config: TrainingConfig,
        beginning: Beginning,
        images: dict[str, int],
        checks: Mapping[str, Sequence[Batch]],
        log: RunLog,
        out: Path,
        watcher: Watcher,
    ) -> None:
        self._config, self._log, self._out, self._watcher = config, log, out, watcher
        self._learner, self._ancestors, self._images = beginning.learner, beginning.ancestors, images
        self._device = self._learner.log_sharpness.device
        self._checks = {name: [_moved(batch, self._device) for batch in batches] for name, batches in checks.items()}
        self._losses = list[float]()
        self._began, self._steps_done = time.monotonic(), 0
        self._seconds_before, self._hardware_before = beginning.seconds, beginning.hardware

    def baseline(self) -> None:
        """What gradient features alone do on the validation pairs."""
        results = {name: validate(None, batches) for name, batches in self._checks.items()}
        self._log.add("baseline", 0, right={name: right for name, (right, _) in results.items()})

    def step(self, step: int, batch: Batch) -> None:
        """Learn from a batch; `step` counts from 0."""
        config, learner = self._config, self._learner
        rate = learning_rate(config.schedule, step)
        for group in learner.optimiser.param_groups:
            group["lr"] = rate
        loss = training_loss(learner.network, learner.log_sharpness, batch, [config.seed, step])
        learner.optimiser.zero_grad()
        torch.autograd.backward(loss)
        nn.utils.clip_grad_norm_(learner.network.parameters(), config.schedule.max_gradient_norm)
        learner.optimiser.step()
        self._losses.append(_finite("the loss", float(loss.detach()), step + 1, self._out))
        self._after(step + 1, rate)

    def _after(self, done: int, rate: float) -> None:
        schedule, last = self._config.schedule, done == self._config.schedule.steps
        self._steps_done += 1
        mean = sum(self._losses) / len(self._losses)
        self._watcher.stepped(done, schedule.steps, mean, (time.monotonic() - self._began) / self._steps_done)
        if done % schedule.log_every == 0 or last:
            sharpness = _finite("the sharpness", float(self._learner.log_sharpness.detach().exp()), done, self._out)
            self._log.add("loss", done, loss=mean, sharpness=sharpness, learning_rate=rate, seconds=round(self._seconds(), 1))
            self._losses.clear()
        if done % schedule.check_every == 0 or last:
            self._check(done)

    def _check(self, done: int) -> None:
        self._learner.network.eval()
        results = {name: validate(self._learner.network, batches) for name, batches in self._checks.items()}
        self._learner.network.train()
        right, margin = ({name: result[k] for name, result in results.items()} for k in (0, 1))
        for name, value in margin.items():
            _finite(f"the margin on {name}", value, done, self._out)
        self._log.add("validation", done, right=right, margin=margin)
        save_checkpoint(self._out / CHECKPOINT, self._checkpoint(done))
        write_file(self._out / CURVES, _drawn(self._log, self._config.schedule.steps).encode())
        baseline = self._log.of("baseline")
        gradient = baseline[0]["right"] if baseline else {}
        self._watcher.validated(done, *({name: 1 - share for name, share in part.items()} for part in (right, gradient)))

    def _checkpoint(self, done: int) -> Checkpoint:
        learner = self._learner
        return Checkpoint(
            done,
            self._seconds(),
            self._config.plain(),
            learner.network.state_dict(),
            learner.log_sharpness.detach(),
            learner.optimiser.state_dict(),
            torch.get_rng_state(),
            on_all(self._hardware_before, hardware(self._device, self._config.threads)),
            self._ancestors,
            self._images,
        )

    def _seconds(self) -> float:
        return self._seconds_before + time.monotonic() - self._began


def _moved(batch: Batch, device: torch.device) -> Batch:
    return batch if device.type == "cpu" else Batch(**{f.name: getattr(batch, f.name).to(device) for f in fields(batch)})


def _drawn(log: RunLog, steps: int) -> str:
    checks, baseline = log.of("validation"), log.of("baseline")
    names = list(checks[-1]["right"]) if checks else []
    wrong = {name: [(entry["step"], 1 - entry["right"][name]) for entry in checks] for name in names}
    gradient = {name: 1 - right for name, right in baseline[0]["right"].items()} if baseline else {}
    return curves_svg([(entry["step"], entry["loss"]) for entry in log.of("loss")], wrong, gradient, steps)


def _finite(what: str, value: float, step: int, out: Path) -> float:
    """A figure without which nothing can be learned any more; it is told before the checkpoint would hold what made it so."""
    if not math.isfinite(value):
        raise ModelError(
            f"{what} is {value} at step {step}",
            where=str(out),
            remedy="lower schedule.learning_rate and train into another folder",
        )
    return value
