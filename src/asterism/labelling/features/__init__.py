"""What weak classifiers measure of a few points, and the tree search over such measures: for anchors and partial solvers alike."""
