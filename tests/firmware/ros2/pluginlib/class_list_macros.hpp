// As pluginlib's: a class can be made from the library by name. Here a function of C makes the only one.
#pragma once
#define PLUGINLIB_EXPORT_CLASS(Derived, Base) \
  extern "C" Base * make_plugin(); \
  extern "C" Base * make_plugin() { return new Derived; }
