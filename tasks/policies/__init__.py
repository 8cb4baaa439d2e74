"""Policies: what to do on what is observed. The baselines of every environment, and how to bring one's own."""
