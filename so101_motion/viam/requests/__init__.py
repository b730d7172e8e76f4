"""What the models answer beyond Viam's own methods: the published module's requests and ours."""
