"""Receivers over REST: webhooks, their state and their dead letters. All of it needs the scope admin."""
