"""Cells coupled by loads through ports on one shared field."""
