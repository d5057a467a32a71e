#include "chip.h"

// Longest first filter allowed, as a code: 0 to 3 for 6, 10, 18, 34 samples.
#ifndef FILTER_MAX
#define FILTER_MAX 3
#endif

static const uint8_t CHARGE_CURRENT = 16;   // uA, before the chip has chosen; unused afterwards
static const uint16_t SCAN_BUDGET = 900;    // us of the 1 ms between two samples of an electrode

void Chip::name(uint8_t chip_address) {
  address = chip_address;
  letter = 'A' + (chip_address - 0x5A);
  memset(touch, 40, sizeof touch);
  memset(release, 20, sizeof release);
}

uint8_t Chip::afe1() const { return uint8_t(filter << 6) | CHARGE_CURRENT; }

uint16_t Chip::scanMicros(uint8_t code) const {
  static const uint8_t samples[4] = {6, 10, 18, 34};
  // A sample takes the charge time twice: charge, then discharge. Charge time is 2^(code - 1) half microseconds.
  uint16_t times = 0;
  for (uint8_t e = 0; e < ELECTRODES; ++e) {
    const uint8_t time = charge[13 + e / 2] >> (e & 1 ? 4 : 0) & 7;
    times += time ? 1u << (time - 1) : 1;
  }
  return samples[code] * times;
}

bool Chip::setUp() {
  // Baseline filter of DataStream, 0x2B to 0x35
  static const uint8_t baseline_filter[11] = {1, 1, 0x10, 0x20, 1, 1, 0x10, 0x20, 1, 0x10, 0xFF};
  uint8_t afe2;
  bool ok = bus::write(address, 0x80, 0x63) && bus::read(address, 0x5D, &afe2, 1) && afe2 == 0x24;
  for (uint8_t i = 0; ok && i < sizeof baseline_filter; ++i) ok = bus::write(address, 0x2B + i, baseline_filter[i]);
  for (uint8_t e = 0; ok && e < ELECTRODES; ++e)
    ok = bus::write(address, 0x41 + 2 * e, touch[e]) && bus::write(address, 0x42 + 2 * e, release[e]);
  if (!charge_known) filter = 1;
  ok = ok && bus::write(address, 0x5B, 0) && bus::write(address, 0x5C, afe1()) && bus::write(address, 0x5D, AFE2);
  if (ok && !charge_known) {
    // Upper limit, lower limit and target at 3.3 V; then the chip runs once to find currents and times.
    ok = bus::write(address, 0x7D, 201) && bus::write(address, 0x7E, 130) && bus::write(address, 0x7F, 180) &&
         bus::write(address, 0x7B, uint8_t(filter << 6) | 0x01) && bus::write(address, 0x5E, RUN);
    if (ok) delay(20);
    ok = ok && bus::write(address, 0x5E, 0) && bus::write(address, 0x7B, uint8_t(filter << 6)) &&
         bus::read(address, 0x5F, charge, sizeof charge);
    charge_known = ok;
    if (ok) {
      filter = FILTER_MAX;
      while (filter > 0 && scanMicros(filter) > SCAN_BUDGET) --filter;
      ok = bus::write(address, 0x5C, afe1());
    }
  } else {
    for (uint8_t i = 0; ok && i < sizeof charge; ++i) ok = bus::write(address, 0x5F + i, charge[i]);
  }
  ok = ok && bus::write(address, 0x5E, RUN);
  running_since = last_read = read_before = micros();
  lost = !ok;
  return ok;
}

bool Chip::intact() {
  uint8_t found[3];
  return bus::read(address, 0x5C, found, 3) && found[0] == afe1() && found[1] == AFE2 && found[2] == RUN;
}

bool Chip::setThreshold(uint8_t electrode, bool is_release, uint8_t value) {
  (is_release ? release : touch)[electrode] = value;
  // Thresholds are writable in stop mode only.
  const bool ok = bus::write(address, 0x5E, 0) && bus::write(address, 0x41 + 2 * electrode + is_release, value) &&
                  bus::write(address, 0x5E, RUN);
  running_since = micros();
  return ok;
}
