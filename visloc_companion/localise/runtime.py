"""Networks in ONNX Runtime: the ladder of providers, threads that leave the daemon alone, and a self-test before first use.

The only module that imports onnxruntime, and only when a session is opened. What a session answers to the golden input decides
whether it is believed: an accelerator that computes wrong is refused like a changed file.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from visloc_companion.errors import ConfigError, ModelError, VislocError
from visloc_companion.localise.model_folder import (
    COPY_AGAIN,
    Float32Array,
    ModelManifest,
    VariantName,
    read_model,
)

ProviderName = Literal["tensorrt", "cuda", "openvino", "qnn", "cpu"]
PROVIDERS: dict[ProviderName, str] = {
    "tensorrt": "TensorrtExecutionProvider",
    "cuda": "CUDAExecutionProvider",
    "openvino": "OpenVINOExecutionProvider",
    "qnn": "QNNExecutionProvider",
    "cpu": "CPUExecutionProvider",
}
_OPTIONS: dict[ProviderName, dict[str, str]] = {"cuda": {"use_tf32": "0"}}
"""TF32 rounds float32 to 10 bits: wrong by more than a golden vector forgives."""
INSTALL = "pip install 'visloc-companion[cpu]' (or [gpu]), or choose a method that needs no network (gradient)"
_ERRORS_ONLY = 3
NO_TELEMETRY = "ORT_DISABLE_TELEMETRY"
"""Read once, when it is imported. Otherwise the build of 1.31.1 keeps each session in a database of the home folder, with a
number that names the computer and an address of its maker; in flight the network that it would use may be a modem. Who imports
it by name sets this before (app/worker_ahead.py)."""


@dataclass(frozen=True, slots=True)
class NetworkChoice:
    """Which network is wanted, and on what; as in the section `localiser` of the configuration."""

    folder: Path | None = None
    """None: the one that came with this version."""
    providers: tuple[ProviderName, ...] = ("cpu",)
    threads: int | None = None
    """None: one less than the cores."""
    variant: VariantName = "float32"


@dataclass(slots=True)
class NetworkSession:
    """A network that passed its self-test. Belongs to the process that opened it.

    An accelerator that fails later is left for the next provider of the ladder: `provider`, `skipped` and `about` change then.
    """

    manifest: ModelManifest
    variant: VariantName
    provider: ProviderName
    """What really computes."""
    skipped: tuple[str, ...]
    """The providers that were asked for before it, each with why it was passed over or left."""
    threads: int
    run: Callable[[Float32Array], Float32Array]
    """(N, channels, H, W) float32 in, (N, output channels, H, W) float32 out; H and W multiples of `output.multiple_px`."""

    @property
    def about(self) -> str:
        """One line for logs: network, variant, provider, threads, and what was passed over."""
        threads = f"{self.threads} thread" + ("s" if self.threads > 1 else "")
        line = f"{self.manifest.identity} {self.variant} on {self.provider}, {threads}"
        return "; ".join([line, *(f"passed over {why}" for why in self.skipped)])


def default_threads() -> int:
    """One less than the cores that this process may use, at least one: one core is left to the daemon's loop."""
    return max(1, len(os.sched_getaffinity(0)) - 1)


def open_session(
    folder: Path,
    providers: Sequence[ProviderName] = ("cpu",),
    threads: int | None = None,
    variant: VariantName = "float32",
) -> NetworkSession:
    """Open a model's folder on the first of the providers that is really there, and let it answer the golden input.

    Raises ConfigError where onnxruntime is not installed or has none of the providers, ModelError where a file is missing,
    changed or no such network, or where the answer is wrong.
    """
    manifest, content, golden = read_model(folder, variant)
    where = str(folder / manifest.variants[variant].file)
    threads = threads or default_threads()

    def open_on(wanted: Sequence[ProviderName]) -> NetworkSession:
        session, provider, skipped = _climb(content, wanted, threads, where)
        _check_graph(session, manifest, where)
        opened = NetworkSession(manifest, variant, provider, skipped, threads, _runner(session, manifest.output.name, where))
        _self_test(opened, *golden, where)
        return opened

    opened = open_on(providers)
    opened.run = _leaving_what_fails(opened, open_on, providers)
    return opened


def load_onnx(content: bytes, threads: int | None = None) -> Callable[[Float32Array], Float32Array]:
    """An ONNX file of one input and one output as a function on the CPU, before there is a manifest to check it against.

    For the exporter. Raises ConfigError without onnxruntime, ModelError where it cannot be loaded; the function raises it too.
    """
    session = _start(content, "cpu", threads or default_threads(), "ONNX file")
    return _runner(session, session.get_outputs()[0].name, "ONNX file")


def run_onnx(content: bytes, batch: Float32Array) -> Float32Array:
    """What such a file answers once. Raises as `load_onnx` and its function do."""
    return load_onnx(content)(batch)


def _onnxruntime() -> Any:
    os.environ[NO_TELEMETRY] = "1"
    try:
        import onnxruntime
    except ImportError as why:
        if isinstance(why.__cause__, KeyboardInterrupt):  # its C++ makes an ImportError of Ctrl-C
            raise KeyboardInterrupt from why
        raise ConfigError(f"networks need onnxruntime: {why}", where="localiser.method", remedy=INSTALL) from why
    return onnxruntime


def _climb(
    content: bytes, providers: Sequence[ProviderName], threads: int, where: str
) -> tuple[Any, ProviderName, tuple[str, ...]]:
    """The session on the first provider that works, and why those before it did not."""
    available = _onnxruntime().get_available_providers()
    skipped: list[str] = []
    for name in providers:
        if PROVIDERS[name] not in available:
            skipped.append(f"{name}: not in this build of onnxruntime (it has {', '.join(available)})")
            continue
        try:
            session = _start(content, name, threads, where)
        except ModelError as why:
            if name == "cpu":  # no accelerator is to blame: the network itself is bad
                raise
            skipped.append(f"{name}: {why.what}")
            continue
        got = session.get_providers()[0]
        if got == PROVIDERS[name]:
            return session, name, tuple(skipped)
        skipped.append(f"{name}: onnxruntime fell back to {got}; its libraries or the device are missing")
    raise ConfigError(
        f"no provider can be used ({'; '.join(skipped)})",
        where="localiser.providers",
        remedy='add "cpu" as the last one, or install what they need',
    )


def _start(content: bytes, provider: ProviderName, threads: int, where: str) -> Any:
    ort = _onnxruntime()
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.execution_mode = ort.ExecutionMode.ORT_SEQUENTIAL
    options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_ENABLE_ALL
    options.enable_mem_pattern = False  # a plan is kept for every input size that ever came
    options.log_severity_level = _ERRORS_ONLY
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.add_session_config_entry("session.inter_op.allow_spinning", "0")
    try:
        session = ort.InferenceSession(
            content, options, providers=[(PROVIDERS[provider], _OPTIONS.get(provider, {}))], enable_fallback=0
        )
    except Exception as why:  # onnxruntime's own exceptions have no common base
        raise ModelError(f"cannot be loaded: {_first_line(why)}", where=where, remedy=COPY_AGAIN) from why
    return session


def _runner(session: Any, output: str, where: str) -> Callable[[Float32Array], Float32Array]:
    fed = session.get_inputs()[0].name

    def run(batch: Float32Array) -> Float32Array:
        try:
            answer = session.run([output], {fed: batch})[0]
        except Exception as why:
            raise ModelError(f"does not run on {batch.shape}: {_first_line(why)}", where=where, remedy=COPY_AGAIN) from why
        return np.asarray(answer, dtype=np.float32)

    return run


def _leaving_what_fails(
    session: NetworkSession, open_on: Callable[[Sequence[ProviderName]], NetworkSession], ladder: Sequence[ProviderName]
) -> Callable[[Float32Array], Float32Array]:
    """`session.run`, which goes on with the next provider of the ladder where an accelerator fails on what that one can compute.

    A device that is lost, or has no memory left, fails every frame from then on. What no provider takes is the input's fault.
    """
    run, spares = session.run, dict[ProviderName, NetworkSession]()

    def run_on_what_works(batch: Float32Array) -> Float32Array:
        nonlocal run
        try:
            return run(batch)
        except ModelError as why:
            left = [f"{session.provider}: {why.what}"]
            for name in ladder[ladder.index(session.provider) + 1 :]:
                try:
                    spares[name] = spares.get(name) or open_on((name,))
                    answer = spares[name].run(batch)
                except VislocError as also:
                    left.append(f"{name}: {also.what}")
                    continue
                session.provider, session.skipped, run = name, (*session.skipped, *left), spares[name].run
                return answer
            raise

    return run_on_what_works


def _check_graph(session: Any, manifest: ModelManifest, where: str) -> None:
    """The graph's one input and the named output must be what the manifest says, of any batch, height and width."""
    inputs, outputs = session.get_inputs(), session.get_outputs()
    if [node.name for node in inputs] != [manifest.input.name]:
        raise _unlike(where, "input.name", manifest.input.name, [node.name for node in inputs])
    named = [node for node in outputs if node.name == manifest.output.name]
    if not named:
        raise _unlike(where, "output.name", manifest.output.name, [node.name for node in outputs])
    for field, node, channels in (
        ("input", inputs[0], manifest.input.channels),
        ("output", named[0], manifest.output.channels),
    ):
        shape = list(node.shape or ())
        fixed = [size for axis, size in enumerate(shape) if axis != 1 and isinstance(size, int)]
        if node.type != "tensor(float)" or len(shape) != 4 or (isinstance(shape[1], int) and shape[1] != channels) or fixed:
            raise _unlike(where, field, f"tensor(float) [any, {channels}, any, any]", f"{node.type} {shape}")


def _self_test(session: NetworkSession, given: Float32Array, expected: Float32Array, where: str) -> None:
    """Compare the answer to the golden input with the recorded one; also the warm-up."""
    entry, answer = session.manifest.variants[session.variant], session.run(given)
    if answer.shape != expected.shape:
        raise ModelError(f"answers {answer.shape} to the golden input, {expected.shape} is right", where=where, remedy=COPY_AGAIN)
    difference = np.abs(answer - expected)
    worst, rms = float(difference.max()), float(np.sqrt(np.mean(np.square(difference))))
    if not (worst <= entry.tolerance_max and rms <= entry.tolerance_rms):  # so written that NaN is wrong
        raise ModelError(
            f"answers the golden input wrong on {session.provider}: off by {worst:.3g} at most and {rms:.3g} rms, "
            f"allowed are {entry.tolerance_max:.3g} and {entry.tolerance_rms:.3g}",
            where=where,
            remedy="use another of localiser.providers (cpu), another localiser.model_variant, or export the model again",
        )


def _unlike(where: str, field: str, wanted: object, found: object) -> ModelError:
    return ModelError(f"{field}: the manifest says {wanted}, the graph has {found}", where=where, remedy=COPY_AGAIN)


def _first_line(why: Exception) -> str:
    lines = str(why).strip().splitlines()
    return lines[0] if lines else type(why).__name__
