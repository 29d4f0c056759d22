"""Naive versions that must be seen to fail: the tests assert that they do."""
