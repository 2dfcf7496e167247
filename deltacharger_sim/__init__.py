"""The world behind the emulated hardware: mechanics, contact, magnets and the charging circuit."""
