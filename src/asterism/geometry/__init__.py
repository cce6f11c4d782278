"""Arrays in; rotations, rigid motions, ray intersections and small matrices out."""
