"""Learned networks, off unless a setting names one: their weights come with a package, or are the user's to bring."""
