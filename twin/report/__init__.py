"""What a diagnosis says, as one HTML page: wording, figures, style."""
