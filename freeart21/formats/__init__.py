"""Third-party layouts of recordings and motion, and `convert` between them and ours.

Recordings come with what their folders know of the truth (`third_party.KnownTruth`): methods must not import this.
"""
