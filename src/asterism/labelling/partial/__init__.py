"""The thesis' partial solvers: features, weak classifiers, tree search, solver search and the matrix of votes."""
