"""Rewards, Monte-Carlo returns and checks that follow from labels; the validation viewer (RVV)."""
