"""Teleoperation: a user moves an object and its joint live in a browser and records takes.

- `start`: entry point of the command. `server`: HTTP and websockets; one page drives, others watch; `client` is one.
- `wire`: parses and checks messages of pages. `gate`: token, origin and rate limits.
- `driving`: state of moving, recording, pausing and undoing, without network or simulator. `takes`: files of takes.
- `limits`: where the object may be. `stage`: the live picture, drawn by SAPIEN in `stage_process`. `static/`: the page.
"""
