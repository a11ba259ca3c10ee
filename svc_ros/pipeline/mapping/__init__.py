"""How maps are made: of runs, which are joined where loops between them agree."""
