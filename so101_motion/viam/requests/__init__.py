"""Requests beyond Viam's own methods: the published module's and ours."""
