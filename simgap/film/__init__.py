"""The gap between pictures: an RGB-D video of an asset and the simulated film of it.

`workflow` reads like the five steps. Measure: `scene` (the asset and its poses), `drawing` (the simulated film),
`samples` (where both films are compared). Localise: `maps`. Name: `effects` (camera faults), `geometry`, `colour`,
`pixel_faults` and `linear` (likelihoods), `choose`, `missing` (a part that the asset lacks). Add:
`freeart21.camera_faults`, for the recorder. Show: `proof`, `answer`, `page`.
"""
