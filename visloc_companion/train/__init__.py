"""Training of the feature networks. Needs the extra `train`; never reached by what flies."""
