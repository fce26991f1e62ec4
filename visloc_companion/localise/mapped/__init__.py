"""What the map shows about a place: windows with features, the surface, its gaps and errors, its light."""
