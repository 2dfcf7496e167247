/* SPDX-License-Identifier: Apache-2.0 */
/* An Arduino core that does nothing, so that the sketch links and its size can be measured. */
#include "Arduino.h"

uint32_t micros(void) { return 0; }
void delayMicroseconds(uint32_t) {}
void pinMode(uint32_t, uint32_t) {}
void digitalWrite(uint32_t, uint32_t) {}
int digitalRead(uint32_t) { return LOW; }
void analogReadResolution(int) {}
uint32_t analogRead(uint32_t) { return 0; }
void analogWrite(uint32_t, uint32_t) {}
uint32_t CDC_Itf_TxAvailable(void) { return 0; }
void drv_dxl_begin(uint8_t) {}
void drv_dxl_tx_enable(uint8_t, uint8_t) {}

void UARTClass::setDxlMode(bool) {}
void UARTClass::begin(uint32_t) {}
int UARTClass::read(void) { return -1; }
int UARTClass::availableForWrite(void) { return 0; }
size_t UARTClass::write(const uint8_t *, size_t) { return 0; }
void UARTClass::flush(void) {}

void USBSerial::begin(uint32_t) {}
int USBSerial::available(void) { return 0; }
int USBSerial::read(void) { return -1; }
size_t USBSerial::write(const uint8_t *, size_t) { return 0; }
USBSerial::operator bool() { return false; }

UARTClass Serial1, Serial3;
USBSerial Serial;

static RCC_TypeDef rcc;
static PWR_TypeDef pwr;
static BKP_TypeDef bkp;
static IWDG_TypeDef iwdg;
RCC_TypeDef *const RCC = &rcc;
PWR_TypeDef *const PWR = &pwr;
BKP_TypeDef *const BKP = &bkp;
IWDG_TypeDef *const IWDG = &iwdg;

int main(void)
{
  setup();
  for (;;)
    loop();
}
