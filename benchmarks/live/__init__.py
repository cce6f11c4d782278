"""Frames while they come in: how long labels take over a socket, what a kill costs, what damaged packets do, whether anything grows."""
