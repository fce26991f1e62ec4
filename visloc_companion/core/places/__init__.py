"""Finding the vehicle where its position is not known, or was lost: tiles, hypotheses, tracks."""
