"""A leaderboard in a git repository: what `freeart21 board` writes, scores, signs and checks (docs/board.md)."""
