"""Opens the localiser's network, which answers its golden input as it is opened."""

from __future__ import annotations

from visloc_companion.app.settings import network_choice
from visloc_companion.config import Config
from visloc_companion.doctor.facts import ModelFacts
from visloc_companion.errors import VislocError
from visloc_companion.localise.registry import needs_features, open_features_for


def read_model(config: Config) -> tuple[ModelFacts, tuple[str, str] | None]:
    """The network's state, and name and recipe of its features where it computes some."""
    method = config.localiser.method
    if not needs_features(method):
        return ModelFacts(needed=False), None
    try:
        features = open_features_for(method, network_choice(config.localiser))
    except VislocError as why:
        return ModelFacts(needed=True, problem=str(why)), None
    if features is None:
        return ModelFacts(needed=False), None
    session = features.session
    facts = ModelFacts(True, "", session.about, session.provider, session.skipped, session.variant)
    return facts, (features.name, features.recipe)
