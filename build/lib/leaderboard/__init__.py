"""The scorer: what each number means, measured from files alone, whatever the method."""
