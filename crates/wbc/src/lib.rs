//! Whole-body control.
#![no_std]
