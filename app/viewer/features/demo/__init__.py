"""Demo: play closures, fly cameras, and save pages that play without a server."""
