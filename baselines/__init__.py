"""Three classical methods, made of kept libraries and of nothing of our solver: rows to compare a method with. And the
paper's own segmentation (`paper`), an ablation of our solver.

Each reads a sequence folder as anybody's method would and writes a result folder (`answer.run_baseline`), or declares
why it has none:

- `two_motions`: SIFT (OpenCV) with depth, RANSAC of two rigid motions between keyframes;
- `rigid_clusters`: KLT tracks (OpenCV) with depth, spectral clustering (scikit-learn) of how they keep their distances;
- `masked_icp`: coloured ICP (Open3D) of both parts, whose masks it is GIVEN: a privileged input.

All share the closed-form joint of FreeArtGS (`joint`), and surfaces, masks and views by `surfaces` and `answer`.

A constant without a source (sizes of voxels and windows, least counts and shares) was set by hand and is not measured:
these are rows to compare with, not the best that the methods could do.
"""
