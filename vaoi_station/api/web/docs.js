// The REST interface, drawn from the station's own OpenAPI document; nothing is fetched from elsewhere.
window.SwaggerUIBundle({
  url: new URL("api/v1/openapi.json", location.href).href,
  dom_id: "#interface",
  deepLinking: true,
  validatorUrl: null,
  defaultModelsExpandDepth: 0,
});
