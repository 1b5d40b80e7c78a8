"""Teleoperation: a user moves an object and its joint live in a browser and records takes.

- `start`: entry point of the command.
- `server`: HTTP and websockets; one page drives, others watch. `client` is one page, `connections` bounds connections.
- `wire`: parses and checks messages of pages. `gate`: token, origin and rate limits.
- `driving`: state of moving, recording, pausing and undoing, without network or simulator.
- `takes`, `take_file`: files of takes. `limits`: where the object may be.
- `stage`: the live picture; `stage_process` holds SAPIEN in a process of its own.
- `certificate`, `address`: for pages on other machines. `static/`: the page.
"""
