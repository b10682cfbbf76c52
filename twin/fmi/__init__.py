"""Functional mock-up units: written, updated, described, run."""
