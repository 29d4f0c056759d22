"""Geometry: closed triangulated membrane, fibre-network disc."""
