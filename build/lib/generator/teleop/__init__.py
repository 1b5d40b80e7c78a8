"""Teleoperation: an object and its joint moved by hand, live, in a browser; what was done is a take.

`start` is the door of the command. `wire` reads what a page says and trusts nothing else, `gate` says who gets in,
`clock` brings a page's time to the server's, `driving` is what moving, recording, pausing and undoing mean (no network,
no simulator), `takes` writes it, `stage` shows it (`stage_process`, a process of its own, holds SAPIEN), `limits` is
where the object may be, `server` lets one page drive and others watch, and `static/` is the page.
"""
