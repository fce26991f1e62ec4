"""From hypotheses of the exhaustive search to one place: refined, ranked, held against each other, and what they claim."""
