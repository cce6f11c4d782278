"""Real people labelled by models of virtual ones: no recording of the sets that are judged has taught anything."""
