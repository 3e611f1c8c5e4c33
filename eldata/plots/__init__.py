"""Drawings of plain numbers, for pages and for notebooks; other rooms measure and explain."""
