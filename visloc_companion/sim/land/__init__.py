"""What the procedural landscape is made of: plan, relief, ground, trees, houses, snow and light of a date."""
