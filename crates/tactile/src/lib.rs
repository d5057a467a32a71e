//! The cover.
#![no_std]
