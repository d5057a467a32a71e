// The text that goes to the host: one buffer, a checksum, and no wait for the host anywhere.
#pragma once
#include "chip.h"

namespace line {

// Starts a text; one that was not sent is forgotten.
void begin();
void put(char c);
void text(const char *flash);
void hex(uint8_t value);
void hex(uint16_t value);
void hex(uint32_t value);
// The lower 12 bits, three digits.
void hex12(uint16_t value);
void decimal(int16_t value);
// Ends the line: a space, the CRC-16 (XMODEM) of everything before that space, a line feed.
void seal();

// Whether a text still waits for the host.
bool busy();
// Hands over as much as the host takes now.
void pump();

// The start of a frame's line: letter, sequence, stamp. Its data, flags and checksum follow.
void header(char letter, uint16_t sequence, uint32_t stamp_us);
// The six lines of Bare Conductive's DataStream.
void dataStream(const Chip &chip);

}  // namespace line
