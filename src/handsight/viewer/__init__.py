"""Pictures of corrections and of tracked recordings. They need matplotlib, imported when one is drawn."""
