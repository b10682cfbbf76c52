"""What is looked for in recordings before any fit: findings that block it, or that the user should know."""
