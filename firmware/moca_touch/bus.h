// I2C as a polled master at 400 kHz: no interrupt, no buffer, and no wait that does not end.
#pragma once
#include <Arduino.h>
#include <util/twi.h>

namespace bus {

// Frees the bus from a slave that holds SDA low (up to nine clocks), then makes this board its master.
void begin();

// Writes one register of the chip at `address` (7 bits); false if the chip did not answer in time.
bool write(uint8_t address, uint8_t reg, uint8_t value);

// The steps below are for `read` only.
bool select(uint8_t address, uint8_t reg);
bool wait(uint8_t wanted_status);
bool fail();
void stop();

// Reads `count` registers from `from` on; false if the chip did not answer in time. `each(i)` is called for every byte
// that is there, while the next one is on the wire (22 us): time enough to write it as text.
template <typename Each> bool read(uint8_t address, uint8_t from, uint8_t *to, uint8_t count, Each each) {
  if (!select(address, from)) return fail();
  for (uint8_t i = 0; i < count; ++i) {
    const bool last = i + 1 == count;
    TWCR = _BV(TWINT) | _BV(TWEN) | (last ? 0 : _BV(TWEA));
    if (i > 0) each(i - 1);
    if (!wait(last ? TW_MR_DATA_NACK : TW_MR_DATA_ACK)) return fail();
    to[i] = TWDR;
  }
  stop();
  each(count - 1);
  return true;
}

inline bool read(uint8_t address, uint8_t from, uint8_t *to, uint8_t count) {
  return read(address, from, to, count, [](uint8_t) {});
}

}  // namespace bus
