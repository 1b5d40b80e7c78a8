"""The leaderboard as a static site: one folder that opens from disk or any host and fetches nothing.

`build.write_site` is the door. A page is HTML that says all its numbers without any script; the scripts sort, filter,
play and turn. What is heavy (meshes, masks, curves) is packed into one small script file a sequence (`packed`), because
a page that was opened from disk may load scripts but may not fetch files.
"""
