"""The model: description and tensions to shape, and back."""
