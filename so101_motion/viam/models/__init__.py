"""The Viam resources, one file a model: validate, convert, call, convert back."""
