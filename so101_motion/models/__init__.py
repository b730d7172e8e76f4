"""The Viam resources, one file a model, each thin: validate, convert, call, convert back."""
