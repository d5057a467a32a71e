#include "line.h"
#include <util/crc16.h>

namespace line {

static char buffer[300];
static uint16_t length = 0, sent = 0, sum = 0;
// A packet of the full 64 bytes would owe the host an empty one after it.
static const uint8_t PACKET = 63;

void begin() {
  length = sent = 0;
  sum = 0;
}

void put(char c) {
  if (length == sizeof buffer) return;
  buffer[length++] = c;
  sum = _crc_xmodem_update(sum, c);
}

void text(const char *flash) {
  while (const char c = pgm_read_byte(flash++)) put(c);
}

static void digit(uint8_t value) {
  value &= 15;
  put(value < 10 ? '0' + value : 'A' - 10 + value);
}

void hex(uint8_t value) {
  digit(value >> 4);
  digit(value);
}

void hex(uint16_t value) {
  hex(uint8_t(value >> 8));
  hex(uint8_t(value));
}

void hex(uint32_t value) {
  hex(uint16_t(value >> 16));
  hex(uint16_t(value));
}

void hex12(uint16_t value) {
  digit(value >> 8);
  hex(uint8_t(value));
}

void decimal(int16_t value) {
  if (value < 0) {
    put('-');
    value = -value;
  }
  bool any = false;
  for (int16_t power = 1000; power; power /= 10) {
    const char c = '0' + value / power;
    value %= power;
    any = any || c != '0' || power == 1;
    if (any) put(c);
  }
}

void seal() {
  const uint16_t of_text = sum;
  put(' ');
  hex(of_text);
  put('\n');
}

bool busy() { return sent < length; }

void pump() {
  if (!busy()) return;
  if (!Serial.dtr() && !Serial.rts()) {  // nobody has the port open: nothing old may wait for whoever opens it next
    begin();
    return;
  }
  // Serial.write() waits up to 250 ms for room, so it is asked for first.
  while (busy() && Serial.availableForWrite() >= PACKET) {
    const uint16_t rest = length - sent;
    const uint8_t count = rest < PACKET ? rest : PACKET;
    Serial.write(reinterpret_cast<const uint8_t *>(buffer) + sent, count);
    Serial.flush();  // now, not at the next start of frame
    sent += count;
  }
}

void header(char letter, uint16_t sequence, uint32_t stamp_us) {
  begin();
  put(letter);
  put(' ');
  hex(sequence);
  put(' ');
  hex(stamp_us);
  put(' ');
}

static int16_t column(const Chip &chip, uint8_t row, uint8_t e) {
  if (e == ELECTRODES) return 0;  // the virtual proximity electrode, which is off
  switch (row) {
    case 0: return chip.status[e / 8] >> (e % 8) & 1;
    case 1: return chip.touch[e];
    case 2: return chip.release[e];
    case 3: return chip.value(e);
    case 4: return chip.baselineValue(e);
    default: return int16_t(chip.baselineValue(e)) - int16_t(chip.value(e));
  }
}

void dataStream(const Chip &chip) {
  static const char keys[] PROGMEM = "TOUCHTTHS\0RTHS\0FDAT\0BVAL\0DIFF";  // five characters each
  begin();
  for (uint8_t row = 0; row < 6; ++row) {
    for (uint8_t i = 0; i < 5; ++i)
      if (const char c = pgm_read_byte(keys + 5 * row + i)) put(c);
    put(':');
    put(' ');
    for (uint8_t e = 0; e <= ELECTRODES; ++e) {
      decimal(column(chip, row, e));
      put(e < ELECTRODES ? ' ' : '\r');
    }
    put('\n');
  }
}

}  // namespace line
