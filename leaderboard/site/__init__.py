"""The leaderboard as a static site: a folder that opens from disk or any host and loads nothing from elsewhere.

Entry point: `build.write_site`. Every page is one file made of the sections of `freeart21.view`, and has all numbers
without scripts, which sort, play and turn.
"""
