"""Classifiers on feature sets, and the published systems that are made of them."""
