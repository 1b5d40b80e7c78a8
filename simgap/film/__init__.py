"""The gap between pictures: an RGB-D video of an asset against the simulated film of it.

`workflow` reads like the five steps. Measure: `scene` (the asset and where it was), `drawing` (the simulated film),
`samples` (where both films are compared). Where: `maps`. Name: `effects` (what a camera may do), `geometry`, `colour`,
`counts` and `linear` (how likely a film is), `choose`, `missing` (a part that the asset lacks). Add:
`freeart21.camera_faults`, which the recorder takes. Show: `proof`, `answer`, `page`.
"""
