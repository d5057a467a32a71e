#include "bus.h"

namespace bus {

static const uint32_t CLOCK_HZ = 400000;
// SCL and SDA are PD0 and PD1 of the ATmega32U4.
static const uint8_t SCL_PIN = _BV(0), SDA_PIN = _BV(1);

// At most about 250 us, ten times what a byte takes.
static bool interruptFlag() {
  for (uint16_t turn = 0; turn < 400; ++turn)
    if (TWCR & _BV(TWINT)) return true;
  return false;
}

bool wait(uint8_t wanted_status) { return interruptFlag() && TW_STATUS == wanted_status; }

void stop() { TWCR = _BV(TWINT) | _BV(TWSTO) | _BV(TWEN); }

bool fail() {
  stop();
  return false;
}

static bool start(uint8_t address_and_direction, uint8_t wanted_status) {
  TWCR = _BV(TWINT) | _BV(TWSTA) | _BV(TWEN);
  if (!interruptFlag() || (TW_STATUS != TW_START && TW_STATUS != TW_REP_START)) return false;
  TWDR = address_and_direction;
  TWCR = _BV(TWINT) | _BV(TWEN);
  return wait(wanted_status);
}

static bool put(uint8_t value) {
  TWDR = value;
  TWCR = _BV(TWINT) | _BV(TWEN);
  return wait(TW_MT_DATA_ACK);
}

bool select(uint8_t address, uint8_t reg) {
  return start(address << 1, TW_MT_SLA_ACK) && put(reg) && start(address << 1 | 1, TW_MR_SLA_ACK);
}

bool write(uint8_t address, uint8_t reg, uint8_t value) {
  if (!start(address << 1, TW_MT_SLA_ACK) || !put(reg) || !put(value)) return fail();
  stop();
  return true;
}

void begin() {
  TWCR = 0;
  PORTD &= ~(SCL_PIN | SDA_PIN);
  for (uint8_t clock = 0; clock < 9 && !(PIND & SDA_PIN); ++clock) {
    DDRD |= SCL_PIN;
    delayMicroseconds(5);
    DDRD &= ~SCL_PIN;
    delayMicroseconds(5);
  }
  DDRD |= SDA_PIN;  // a STOP: SDA rises while SCL is high
  delayMicroseconds(5);
  DDRD &= ~SDA_PIN;
  delayMicroseconds(5);
  PORTD |= SCL_PIN | SDA_PIN;  // weak pull-ups beside the board's
  TWSR = 0;
  TWBR = (F_CPU / CLOCK_HZ - 16) / 2;
  TWCR = _BV(TWEN);
}

}  // namespace bus
