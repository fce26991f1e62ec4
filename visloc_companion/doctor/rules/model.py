"""The localiser's network and what it computes on."""

from __future__ import annotations

from visloc_companion.doctor.facts import Facts
from visloc_companion.doctor.finding import Finding, Rule, amber, green, red, skipped


def _without(facts: Facts) -> Finding | None:
    if facts.model is None:
        return skipped("no network was tried", "give --config FILE")
    if not facts.model.needed:
        return green(f"localiser.method = {facts.assumed.localiser.method} needs none")
    return None


def _opens(facts: Facts) -> Finding:
    early = _without(facts)
    if early is not None or facts.model is None:
        return early or skipped("", "")
    return red(facts.model.problem) if facts.model.problem else green(facts.model.about)


def _provider(facts: Facts) -> Finding:
    early = _without(facts)
    if early is not None or facts.model is None:
        return early or skipped("", "")
    if facts.model.problem:
        return skipped("the network could not be opened", "see model-golden")
    passed = "; ".join(facts.model.skipped)
    return amber(f"{facts.model.provider}; passed over {passed}") if passed else green(facts.model.provider)


def _twice(facts: Facts) -> Finding:
    if facts.config is None:
        return skipped("no configuration", "give --config FILE")
    every = facts.config.localiser.check_every
    read = f"localiser.check_every = {every}"
    return green(read) if every else amber(read)


RULES: tuple[Rule, ...] = (
    Rule(
        "model-golden",
        "the network's files, its answer to the golden input",
        "A network that is damaged, or an accelerator that computes something else, gives wrong places with good marks.",
        "what it says; localiser.providers = [\"cpu\"], or pip install 'visloc-companion[cpu]'",
        _opens,
    ),
    Rule(
        "model-provider",
        "localiser.providers",
        "What was asked for first does not compute: the localiser is slower than meant.",
        "install the runtime and driver of the provider that was passed over, or take it out of localiser.providers",
        _provider,
    ),
    Rule(
        "model-checked",
        "localiser.check_every",
        "Without computing some fixes a second time, a computer that errs in flight goes unnoticed.",
        "localiser.check_every = 20 (5 % of the localiser's time)",
        _twice,
    ),
)
"""About the network."""
