"""An object followed while it is manipulated."""
