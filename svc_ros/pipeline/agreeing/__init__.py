"""How loops of a run speak for and against each other; `pipeline.agreement` tells what follows."""
