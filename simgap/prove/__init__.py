"""The effects added to the asset, and SAPIEN's replay of runs with them."""
