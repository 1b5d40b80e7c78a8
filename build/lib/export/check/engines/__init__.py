"""The engines in which assets are tried, one file each, all behind `base.World`."""
