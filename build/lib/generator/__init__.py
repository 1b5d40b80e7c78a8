"""The recorder: SAPIEN scenes of articulated objects become sequences, with the truth apart from the video."""
