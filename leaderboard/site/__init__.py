"""The leaderboard as a static site: a folder that opens from disk or any host and loads nothing from elsewhere.

Entry point: `build.write_site`. Pages have all numbers without scripts, which sort, filter, play and turn. Meshes,
masks and curves of a sequence are packed into one script file (`packed`), because a page opened from disk may load
scripts but no other files.
"""
